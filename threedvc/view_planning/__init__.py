# SPDX-License-Identifier: MIT
"""Next best views: what is not known yet, and from where it can be seen."""
