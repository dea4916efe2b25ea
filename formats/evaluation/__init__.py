# SPDX-License-Identifier: MIT
"""What a stream holds and how good it is: statistics, comparison with a reference."""
