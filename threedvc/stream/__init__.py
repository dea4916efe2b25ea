# SPDX-License-Identifier: MIT
"""The syntax of a stream: packets, their headers, batches."""
