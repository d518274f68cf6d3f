"""A package for a device of one's own, from templates: driver, double, tests and README."""

import re
from importlib import resources
from pathlib import Path
from typing import Literal

from deformscope_drivers.errors import DeviceError
from deformscope_drivers.interface import DRIVERS

PackageKind = Literal["force", "camera", "tactile", "arm", "hand"]
NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


def write_package(parent: Path, name: str, kind: PackageKind) -> Path:
    """Write the folder `name` in a parent folder; its path. Raises DeviceError for a name that cannot be used, or a
    folder that exists."""
    if not NAME.fullmatch(name):
        raise DeviceError("lower case letters, digits and _ in a name, a letter first", repr(name), "mysensor")
    folder = parent / name
    if name in DRIVERS or folder.exists():
        raise DeviceError("a new name", "a driver's" if name in DRIVERS else "a folder's", "another one", folder)
    templates = resources.files("deformscope_drivers") / "templates"
    of_kind = templates / kind
    files = {
        "pyproject.toml": templates / "pyproject.txt",
        "README.md": templates / "README.txt",
        f"deformscope_{name}/__init__.py": of_kind / "__init__.txt",
        f"deformscope_{name}/double.py": of_kind / "double.txt",
        f"tests/test_{name}.py": of_kind / "test_NAME.txt",
    }
    for path, template in files.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(template.read_text(encoding="utf-8").replace("NAME", name), encoding="utf-8")
    return folder
