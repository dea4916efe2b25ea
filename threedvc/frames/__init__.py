# SPDX-License-Identifier: MIT
"""What comes in: frames, sequences of one or several sensors, and the noise of depth."""
