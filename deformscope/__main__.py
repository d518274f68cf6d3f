"""`python -m deformscope`: the same as the `deformscope` command."""

import sys

from deformscope.cli import main

if __name__ == "__main__":
    sys.exit(main())
