"""``python -m bgn.robot.twin``: the same as ``bgn robot twin``."""

import sys

from bgn.robot.twin.command import main

if __name__ == "__main__":
    sys.exit(main())
