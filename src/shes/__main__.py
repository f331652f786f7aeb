"""`python -m shes`: the same as the `shes` command."""

import sys

from shes.cli import main

if __name__ == "__main__":
    sys.exit(main())
