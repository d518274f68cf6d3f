"""The picture of the layers, out of the imports of every file: python tools/layers.py [--write]

Prints it, or puts it into docs/developers/architecture.md, which `tests/test_structure.py` holds to what this prints.
"""

import argparse
import sys
import textwrap
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "developers" / "architecture.md"
BEGIN, END = "<!-- layers -->\n```text\n", "```\n<!-- end of layers -->"
WIDTH = 118


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="replace the picture in docs/developers/architecture.md")
    picture = drawing()
    if not parser.parse_args().write:
        print(picture, end="")
        return 0
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    PAGE.write_text(before + BEGIN + picture + END + rest.split(END)[1], encoding="utf-8")
    return 0


def drawing() -> str:
    """A row for each level: what stands in it imports only what stands in rows below it."""
    sys.path.insert(0, str(ROOT))
    from tests.test_imports import STAGES as stages
    from tests.test_imports import layer_imports

    layers = layer_imports()
    below = {name: _below(name, layers) for name in layers}

    @cache
    def level(name: str) -> int:
        """How many layers stand below it; layers that import each other stand in one row."""
        return 1 + max((level(one) for one in below[name] if name not in below[one]), default=-1)

    levels: dict[int, list[str]] = {}
    for name in layers:
        levels.setdefault(level(name), []).append(name)
    rows = []
    for number in sorted(levels, reverse=True):
        names = "   ".join(f"[ {name} ]" for name in sorted(levels[number]))
        rows.append(names.center(WIDTH).rstrip())
    return (
        "\n\n".join(rows) + "\n\n" + "\n".join(_imports(name, layers[name], stages) for name in sorted(layers)) + "\n"
    )


def _imports(name: str, imports: set[str], stages: tuple[str, ...]) -> str:
    """What a layer imports; more than two stages in one word, but for a stage itself."""
    many = name not in stages and len(imports.intersection(stages)) > 2
    short = ["stages", *imports.difference(stages)] if many else imports
    listed = ", ".join(sorted(short)) or "nothing of ours"
    return textwrap.fill(listed, WIDTH, initial_indent=f"{name:<16} <- ", subsequent_indent=" " * 20)


def _below(name: str, layers: dict[str, set[str]]) -> set[str]:
    """Everything that a layer imports, directly or by others."""
    found: set[str] = set()
    left = [name]
    while left:
        for one in layers.get(left.pop(), ()):
            if one not in found:
                found.add(one)
                left.append(one)
    return found


if __name__ == "__main__":
    sys.exit(main())
