"""The reference pages of the site, from the code. mkdocs calls this module while it builds (`hooks` in mkdocs.yml).

    python tools/reference_pages.py commands     # print one page

Commands come from their own help, recordings from the classes that are recorded, quantities from their declaration,
keys of a rig file from its sections, and the functions of Python from their docstrings (mkdocstrings). Notebooks are
shown with the outputs that they hold. Files outside `docs/` that pages link (`../drivers/README.md`, pictures) are
copied into the site.
"""

import base64
import contextlib
import dataclasses
import importlib
import inspect
import io
import json
import os
import pkgutil
import re
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
HELP_COLUMNS = "100"
OUTSIDE = re.compile(r"\]\((?:\.\./)+((?:drivers|recordings|studies)/[\w./-]+)")
ABOUT = re.compile(r"^( *```\w+) ([\w.-]+)$", re.MULTILINE)
FIELD_NAMES = re.compile(r"(?:^|; )((?:\w+,\s)*\w+):\s", re.MULTILINE)


def on_config(config: "MkDocsConfig") -> "MkDocsConfig":
    """Have the notebooks below the tutorials."""
    shown = [{_title_of(path): f"notebooks/{path.stem}.md"} for path in notebooks()]
    for section in config.nav or () if shown else ():
        if "Tutorials" in section:
            section["Tutorials"].append({"Notebooks": shown})
    return config


def on_files(files: "Files", config: "MkDocsConfig") -> "Files":
    """Add the pages that are made here, and the files outside `docs/` that pages link."""
    from mkdocs.structure.files import File

    for name, make in PAGES.items():
        files.append(File.generated(config, f"reference/{name}.md", content=make()))
    for path in notebooks():
        page, pictures = notebook_page(path)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=page))
        for name, content in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    linked = {found[1] for page in (ROOT / "docs").rglob("*.md") for found in OUTSIDE.finditer(page.read_text())}
    linked |= {str(page.relative_to(ROOT)) for page in (ROOT / "drivers").glob("*.md")}  # which link one another
    for path in sorted(linked):
        files.append(File.generated(config, f"files/{path}", abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: "Page", config: "MkDocsConfig", files: "Files") -> str:
    """Let links to files outside `docs/` lead to their copies, and blocks of code have their file's name as title."""
    above = "../" * page.file.src_uri.count("/")
    titled = ABOUT.sub(lambda one: one[1] if one[2] == "skip" else f'{one[1]} title="{one[2]}"', markdown)
    return OUTSIDE.sub(rf"]({above}files/\1", titled)


# Commands ------------------------------------------------------------------------------------------------------------


SHARED = """# Commands

From `deformscope COMMAND --help`. Every command that computes takes `--json FILE|-`, `--record FILE.rrd`,
`--viewer auto|native|page|none` and `--overwrite`; those that draw random numbers take `--seed N`.

A SOURCE is a video, a folder of frames (natural order, 8 or 16 bit), images in order, a recording (`.rrd`), pair files
(`.npz`), or a sample: `sample:tension`, `sample:video` (images), `sample:pair`, `sample:cube`, `sample:poke` (pair
files), `sample:squeezes` (for `classify`). Exit codes: [Troubleshooting](../troubleshooting.md).
"""


def commands() -> str:
    """Every command with its own help."""
    from deformscope.cli import COMMANDS

    parts = [SHARED]
    for name, command in COMMANDS.items():
        parts.append(f"## deformscope {name}\n\n{_sentence(command.summary)}\n\n{_help_of(name)}")
    return "\n\n".join(parts) + "\n"


def _help_of(name: str) -> str:
    """The description, and a table of each group of flags."""
    from deformscope.cli import main

    shown = io.StringIO()  # not a terminal: without colours and frames
    with _environment(COLUMNS=HELP_COLUMNS), contextlib.redirect_stdout(shown):
        main([*name.split(), "--help"])
    lines = [line.rstrip() for line in shown.getvalue().strip().splitlines()]
    kept = "\n".join(line for line in lines if set(line.strip()) != {"-"})
    kept, _, example = kept.partition("\nexample:\n")
    usage, description, flags = re.split(r"\n\n+", kept, maxsplit=2)
    parts = [f"```text\n{usage}\n```", _escaped(" ".join(description.split()))]
    parts.append(f"```sh\n{textwrap.dedent(example)}\n```")
    for title, lines in re.findall(r"^ (\S.*)\n((?:(?! \S).*\n?)*)", flags, re.MULTILINE):
        about, rows = _flags_of(lines.splitlines())
        parts += [f"**{title.capitalize()}.** {about}", _table(("flag", "meaning"), rows)]
    return "\n\n".join(parts)


def _flags_of(lines: list[str]) -> tuple[str, list[tuple[str, ...]]]:
    """What stands above the flags of a group, and each flag with its help."""
    about: list[str] = []
    flags: list[tuple[str, list[str]]] = []
    for line in lines:
        if found := re.match(r"  (-.*?|[A-Z]\S*)(?:  +(.*))?$", line):
            flags.append((found[1], [found[2] or ""]))
        else:
            (flags[-1][1] if flags else about).append(line.strip())
    rows = [(f"`{flag}`", _escaped(" ".join(words).strip())) for flag, words in flags]
    return _escaped(" ".join(about)), rows


@contextlib.contextmanager
def _environment(**values: str) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


# Recordings and results -----------------------------------------------------------------------------------------------


def recordings() -> str:
    """Entities of a recording, and the columns of each."""
    from deformscope.rows import ENTITIES, FORMAT, OF_DEVICES, SERIES

    parts = [
        "# Entities and columns of a recording",
        f"Format {FORMAT}. A row is one object of the class that is named; each of its fields is a component"
        " `CLASS:FIELD`. Exports and `ds.open_recording(f).table(ENTITY)` name a column as the field.",
    ]
    devices = {kind: f"{entity}/DEVICE" for kind, entity in OF_DEVICES.items()}
    for kind, entity in {**devices, **ENTITIES, **SERIES}.items():
        meanings = _meanings(kind)
        rows = [
            (f"`{one.name}`", _type_name(one.type), _unit_of(one.name), meanings.get(one.name, ""))
            for one in dataclasses.fields(kind)
        ]
        parts.append(f"## {entity}\n\n`{kind.__name__}`: {_summary(kind)}")
        parts.append(_table(("column", "type", "unit", "meaning"), rows))
    return "\n\n".join(parts) + "\n"


def quantities_page() -> str:
    """What results report: key in the JSON, meaning, unit."""
    from deformscope.results.render import quantities

    parts = [
        "# Quantities of results",
        "Each quantity is declared once, in the class of its result; the terminal's table, the JSON, exports and pages"
        " come from that declaration. A key `GROUP.KEY` is in an object of the JSON.",
        "## `null` and bounds",
        "JSON has no NaN and no infinity: both are `null`. As one end of an interval, `null` means open: the data set"
        " no limit there. Elsewhere it means unknown: a value, a number in a list, an interval or both its ends.",
        "These fields mark a value that is only a bound:",
        _table(
            ("field", "means"),
            [
                (
                    "`verdict`, `beta_verdict`: `at-bound`",
                    "the value is at the end of its range; its interval begins or ends there",
                ),
                (
                    "`verdict`: `unidentified`",
                    "of a yield strain, whose interval is then open above: the value is a lower bound",
                ),
                (
                    "`rigid` of a touch or region, `level_rigid` of a recorded map",
                    "stiffness is a lower bound, and its interval is open above",
                ),
                ("`region_count_at_least`, `at_least` of a recorded map", "there may be more regions than the number"),
            ],
        ),
    ]
    for kind in sorted(_reporting_classes(), key=lambda one: one.__name__):
        meanings = _meanings(kind)
        rows = [
            (f"`{one.key}`", one.label or meanings.get(one.name, ""), one.unit or _unit_of(one.key))
            for one in quantities(kind)
            if one.key is not None
        ]
        parts.append(f"## {kind.__name__}\n\n{_summary(kind)}")
        parts.append(_table(("key in JSON", "meaning", "unit"), rows))
    return "\n\n".join(parts) + "\n"


def _reporting_classes() -> set[type]:
    """Every dataclass of the package that declares a quantity."""
    import deformscope
    from deformscope.results.render import quantities

    found = set()
    for module in pkgutil.walk_packages(deformscope.__path__, "deformscope."):
        if module.name.endswith("__main__"):
            continue
        for one in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(one) and one.__module__.startswith("deformscope") and dataclasses.is_dataclass(one):
                found |= {one} if quantities(one) else set()
    return found


def _unit_of(name: str) -> str:
    """By the longest ending of the name that is a unit."""
    from deformscope.recording.streams import UNITS

    ending = max((one for one in UNITS if name.endswith(f"_{one}")), key=len, default="")
    return UNITS.get(ending, "")


# Rig files ------------------------------------------------------------------------------------------------------------


def rig_file() -> str:
    """Sections of a rig file with their keys, and the keys of each driver."""
    from deformscope.rig.rig_file import SECTIONS
    from deformscope_drivers.interface import DRIVERS

    parts = ["# Keys of a rig file", "A rig file is TOML. [Write a rig file](../howto/write-a-rig-file.md) shows how."]
    for name, kind in SECTIONS.items():
        parts.append(f"## [{name}]\n\n{_summary(kind)}\n\n{_keys(kind)}")
    for name, driver in DRIVERS.items():
        kind = driver.config
        parts.append(f'## [devices.NAME], driver = "{name}"\n\n{_summary(kind)}\n\n{_keys(kind)}')
    return "\n\n".join(parts) + "\n"


def _keys(kind: Any) -> str:
    meanings = _meanings(kind)
    rows = [
        (f"`{one.name}`", _type_name(one.type), _default(one), meanings.get(one.name, ""))
        for one in dataclasses.fields(kind)
        if not one.name.startswith("_")
    ]
    return _table(("key", "type", "default", "meaning"), rows)


def _meanings(kind: type) -> dict[str, str]:
    """What a class says of its fields (`name, other: words`, at the start of a line or after a semicolon), and the
    docstrings of its properties."""
    body = (inspect.getdoc(kind) or "").partition("\n\n")[2].partition("\n\n")[0]
    starts = list(FIELD_NAMES.finditer(body))
    found = {
        name: (inspect.getdoc(member) or "").partition("\n\n")[0]
        for name, member in vars(kind).items()
        if isinstance(member, property)
    }
    ends = [one.start() for one in starts[1:]] + [len(body)] * bool(starts)
    for start, end in zip(starts, ends, strict=True):
        words = " ".join(body[start.end() : end].split()).rstrip(";")
        found |= {name: _escaped(words) for name in start[1].replace("\n", " ").split(", ")}
    return found


def _default(one: dataclasses.Field[Any]) -> str:
    if one.default is not dataclasses.MISSING:
        return f"`{one.default!r}`"
    return "" if one.default_factory is dataclasses.MISSING else f"`{one.default_factory()!r}`"


# Studies --------------------------------------------------------------------------------------------------------------


def studies() -> str:
    """Every study with what it counts."""
    from studies.__main__ import summaries

    about = (
        "In a checkout, `python -m studies NAME` runs a study with the flags of commands for files and pictures."
        " `--resume FILE` keeps each outcome as it comes. [Results](../results/coverage.md) has what they found."
    )
    rows = [(f"`{name}`", _escaped(said)) for name, said in summaries().items()]
    return f"# Studies\n\n{about}\n\n{_table(('study', 'what it counts'), rows)}\n"


# Python ---------------------------------------------------------------------------------------------------------------


def python() -> str:
    """The functions and results of `import deformscope as ds`."""
    import deformscope

    parts = [
        "# Python",
        "`import deformscope as ds`. [Use from Python](../howto/use-from-python.md) shows them at work.",
    ]
    for name in deformscope.__all__:
        if not name.startswith("__"):
            home = getattr(deformscope, name).__module__
            parts.append(f"::: {home}.{name}")
    return "\n\n".join(parts) + "\n"


# Sources of imports ---------------------------------------------------------------------------------------------------

READ_HEAD = ("source", "message, column or file", "unit", "frame", "clock", "refused or asked")


def what_we_read() -> str:
    """Every source of an import: how its units, frames and clock are known, and what is refused."""
    parts = [
        "# What we read",
        "One row a source of `deformscope import`. Keys of the map are in [Map files](map-file.md). What a source does"
        " not say is a key of the map, and an import without it is refused by the key's name.",
        _table(READ_HEAD, read_rows()),
    ]
    return "\n\n".join(parts) + "\n"


def read_rows() -> list[tuple[str, ...]]:
    """Its rows, with the names that the code reads by."""
    from deformscope.imports.frame_builder import CLOUDS, STANDARD
    from deformscope.imports.image_messages import COLOR_ENCODINGS, DEPTH_ENCODINGS
    from deformscope.imports.readers import BAGS, FILES, TABLES

    def of(kind: str) -> str:
        return ", ".join(f"`{name}`" for name, (known, columns) in STANDARD.items() if known == kind and columns)

    def listed(*names: str) -> str:
        return ", ".join(f"`{name}`" for name in names)

    bag = f"bag ({listed(*BAGS)}, or a ROS 2 folder)"
    stamps = '`header`, or `time = "log"`; of another clock: `offset_s`'
    files = "`time`: a text file of stamps, or `rate_hz`"
    images = [one for one in FILES if one not in CLOUDS]
    ours = "Parquet, MCAP or CSV that `deformscope export` wrote"
    turned = "`rotation`; Universal Robots' `actual_TCP_pose_3..5` is a vector"
    counted = "`16UC1` mm (REP 118), `mono16` by the camera's topic (`.../option/Depth_Units/value`), else `unit_m`"
    axes = "by rows, else projected into the map's camera; `axes`"
    behind = "points behind the camera, or whose order is not that of an image"
    nothing = "8 bits, JPEG, an unknown format, units that contradict"
    return [
        ("own export", ours, "in the columns' names", "as recorded", "as recorded", "a newer schema version"),
        (bag, of("wrench"), "N, N m (REP 103)", "the sensor's", stamps, 'NaN without `nan = "keep"`'),
        (bag, of("arm"), "m, rad (REP 103)", "that of the message", stamps, "no unit quaternion"),
        (
            bag,
            "`JointState` with a topic of poses, or of transforms of any type (`transforms`, and `tf_static`)",
            "m, rad (REP 103)",
            "`pose`, `parent`, `child`",
            stamps,
            "no chain from `child` up to `parent`; states beyond `pose_age_s` are losses",
        ),
        (bag, f"`Image` as {listed(*DEPTH_ENCODINGS)}", f"{counted}; `32FC1` m", "the camera's", stamps, nothing),
        (
            bag,
            "`CompressedImage`: `16UC1; png compressed`, `16UC1` or `32FC1; compressedDepth` with `png` or `rvl`",
            f"{counted}; `32FC1` by the two numbers of its head",
            "the camera's",
            stamps,
            nothing,
        ),
        (bag, f"`Image` as {listed(*COLOR_ENCODINGS)}; `CompressedImage`", "", "", stamps, "other encodings"),
        (bag, "`PointCloud2`", "m; beyond 20 m `units.points` is asked for", axes, stamps, behind),
        (bag, "lists of matrices, as `LIST.FIELD`", "`units`", "`pads`", stamps, "sizes in another order; NaN"),
        (
            f"table ({listed(*TABLES)})",
            "`columns`",
            "`units`, or the header's: another one is refused",
            f"{turned}; one force column is along its axis",
            "`time`, `time_unit`; times of day and dates by themselves",
            "no unit; a name of two columns (`Fx#3`); a list without its part (`F[0]`); a cut last line is a loss",
        ),
        (
            f"folder of {listed(*images)}",
            "distances or colours",
            "`unit_m`",
            "the camera's",
            files,
            "no `unit_m`; JPEG",
        ),
        (f"folder of {listed(*CLOUDS)}", "`x`, `y`, `z`", "`units.points`", axes, files, f"no unit; {behind}"),
        (bag, "messages that are not of ROS 1 or 2, services", "", "", "", "listed as not read; the rest is imported"),
    ]


# Licences -------------------------------------------------------------------------------------------------------------


def licences() -> str:
    """The licence of each package that an installation brings, as its metadata says."""
    from importlib import metadata

    from packaging.requirements import Requirement

    found: dict[str, tuple[str, ...]] = {}
    left = [Requirement(one) for one in metadata.requires("deformscope") or () if "extra ==" not in one]
    while left:
        name = left.pop().name
        try:
            about = metadata.metadata(name)
        except metadata.PackageNotFoundError:
            continue  # of another system or Python
        if about["Name"] in found:
            continue
        classified = [one.split(" :: ")[-1] for one in about.get_all("Classifier") or () if one.startswith("License")]
        stated = (about.get("License") or "").partition("\n")[0]
        named = about.get("License-Expression") or ", ".join(classified) or stated
        found[about["Name"]] = (about["Name"], about["Version"], named)
        wanted = [Requirement(one) for one in metadata.requires(name) or ()]
        left += [one for one in wanted if one.marker is None or one.marker.evaluate({"extra": ""})]
    rows = [found[name] for name in sorted(found, key=str.lower)]
    about_it = "What `pip install deformscope` brings, from the packages' metadata where this page was made."
    return f"# Licences of dependencies\n\n{about_it}\n\n{_table(('package', 'version', 'licence'), rows)}\n"


# Notebooks ------------------------------------------------------------------------------------------------------------


def notebooks() -> list[Path]:
    """In the order of their names."""
    return sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def notebook_page(path: Path) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and its pictures by their names."""
    how = "[How to run it](../howto/run-a-notebook.md)"
    parts, pictures = [f"[{path.name}]({path.name}) is this page as a notebook. {how}."], dict[str, bytes]()
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(f"```python\n{source}\n```" if cell["cell_type"] == "code" else source)
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{path.stem}-{len(pictures)}.png"
                pictures[name] = base64.b64decode("".join(data["image/png"]))
                parts.append(f"![What the cell draws]({name})")
            elif "text/html" in data:  # without an empty line, which would end it
                parts.append("\n".join(line for line in "".join(data["text/html"]).splitlines() if line.strip()))
            elif shown := "".join(output.get("text", data.get("text/plain", ""))).rstrip():
                parts.append(f"```text\n{shown}\n```")
    return "\n\n".join([*parts[1:2], parts[0], *parts[2:]]) + "\n", pictures


def _title_of(path: Path) -> str:
    """The heading of a notebook, else its name."""
    heading = re.search(r"^# (.+)$", notebook_page(path)[0], re.MULTILINE)
    return heading[1] if heading else path.stem


# Markdown -------------------------------------------------------------------------------------------------------------


def _summary(kind: type) -> str:
    """The first paragraph of a class's docstring."""
    words = inspect.getdoc(kind) or ""
    return "" if words.startswith(f"{kind.__name__}(") else _escaped(words.partition("\n\n")[0])


def _escaped(words: str) -> str:
    """For Markdown, which takes what stands between backticks as it is."""
    return re.sub(r"(`[^`]*`)|\[(?![^\]]*\]\()|<", lambda m: m[1] or {"[": "\\[", "<": "&lt;"}[m[0]], words)


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:] + "."


def _type_name(kind: Any) -> str:
    return f"`{kind}`" if isinstance(kind, str) else f"`{getattr(kind, '__name__', kind)}`"


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    if not rows:
        return ""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def _cell(text: str) -> str:
    """A bar outside of code would part cells."""
    return text if text.startswith("`") else text.replace("|", r"\|")


PAGES: dict[str, Callable[[], str]] = {
    "commands": commands,
    "recordings": recordings,
    "quantities": quantities_page,
    "rig-file": rig_file,
    "what-we-read": what_we_read,
    "python": python,
    "licences": licences,
    "studies": studies,
}

if __name__ == "__main__":
    sys.path[:0] = [str(ROOT), str(ROOT / "drivers")]
    print(PAGES[sys.argv[1]]())
