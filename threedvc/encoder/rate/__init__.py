# SPDX-License-Identifier: MIT
"""What to send: model updates, their order and the bits they may take."""
