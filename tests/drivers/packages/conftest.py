"""The vendors' packages are found as if they were installed."""

import sys
from pathlib import Path

PACKAGES = Path(__file__).parents[3] / "drivers" / "packages"
sys.path += [str(folder) for folder in sorted(PACKAGES.iterdir()) if folder.is_dir()]
