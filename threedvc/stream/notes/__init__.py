# SPDX-License-Identifier: MIT
"""What META packets tell beside the frames: a module for each kind, whose ``NOTE`` the decoder finds here."""
