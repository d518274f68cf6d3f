"""The site builds without a warning, its tutorials run as typed, and what it quotes is there."""

import base64
import json
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.executor.test_tasks import paths_of_tests
from tools.printed import LEFT_OUT, NUMBER, is_same, renewed, row_of

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
HOWTO = sorted((DOCS / "howto").glob("*.md"))
EXPLANATION = sorted((DOCS / "explanation").glob("*.md"))
DEVELOPERS = [*sorted((DOCS / "developers").glob("add-*.md")), DOCS / "developers" / "engine.md"]
BLOCK = re.compile(r"```(\w*)( [^\n]*)?\n(.*?)```", re.DOTALL)
LONGEST, SHARE = 25, 0.95
"""Words of a sentence, and the share of sentences with as many at most."""
OF_HOWTO, OF_EXPLANATION, OF_ALL = 400, 900, 24_000
"""Words at most: of a page, and of all pages that are written by hand, but those of results."""
TYPED, WIDEST = ("", "sh", "python", "toml"), 100
"""Kinds of blocks that a reader types or copies, and their columns at most."""
IN_REAL_TIME = ("recordings-as-tables", "simulated-rig")
"""Pages that print how many readings devices sent."""
ENDED = (0, 3)
"""Done, and done with losses, as of a double on a busy machine."""


def page_name(path: Path) -> str:
    return str(path.relative_to(DOCS))


def words(page: Path) -> int:
    """Those with a letter, of what is written by hand: neither numbers nor the list that `tools/layers.py` writes."""
    text = re.sub(r"<!-- layers -->.*<!-- end of layers -->", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return sum(bool(re.search("[A-Za-z]", one)) for one in text.split())


def typed_lines(block: str) -> list[str]:
    """The lines of a block, each whole, as a shell reads them: one that ends in a backslash goes on in the next."""
    return block.replace("\\\n", "").splitlines()


def environment() -> dict[str, str]:
    programs = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return paths_of_tests() | {"PATH": programs, "NO_MKDOCS_2_WARNING": "1", "DISABLE_MKDOCS_2_WARNING": "true"}


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the site needs pip install 'deformscope[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True)
    assert (built.returncode, built.stdout + built.stderr) == (0, "")
    assert "hard_stop_n" in (tmp_path / "reference" / "rig-file.html").read_text(encoding="utf-8")
    assert [made.name for made in tmp_path.rglob("*.html") if "```" in made.read_text(encoding="utf-8")] == []
    start = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'(?:<script[^>]* src|<link[^>]* rel="stylesheet"[^>]* href)="(?:https?:)?//[^"]*', start) == []


def test_the_sites_settings_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of the build, which is slow: theme, plugins and extensions are there, and take their options."""
    monkeypatch.setenv("NO_MKDOCS_2_WARNING", "1")
    monkeypatch.setenv("DISABLE_MKDOCS_2_WARNING", "true")
    config = pytest.importorskip("mkdocs.config").load_config(str(ROOT / "mkdocs.yml"))
    assert config["strict"]
    assert {"material/search", "redirects", "mkdocstrings"} <= config["plugins"].keys()


def test_every_page_stands_in_the_navigation() -> None:
    named = set(
        re.findall(r"[\w/-]+\.md", str(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]))
    )
    made = {f"reference/{name}.md" for name in runpy.run_path(str(ROOT / "tools" / "reference_pages.py"))["PAGES"]}
    assert {page_name(page) for page in DOCS.rglob("*.md")} | made == named


def test_a_notebook_is_shown_with_its_outputs(tmp_path: Path) -> None:
    png = b"\x89PNG"
    drawn = {"output_type": "display_data", "data": {"image/png": base64.b64encode(png).decode(), "text/plain": "<F>"}}
    said = {"output_type": "stream", "name": "stdout", "text": ["beta\n", "0.5\n"]}
    cells = [
        {"cell_type": "markdown", "source": ["# A fit\n", "\n", "Words."]},
        {"cell_type": "code", "source": ["print(1)"], "outputs": [said, drawn]},
    ]
    path = tmp_path / "fit.ipynb"
    path.write_text(json.dumps({"cells": cells}), encoding="utf-8")
    page, pictures = runpy.run_path(str(ROOT / "tools" / "reference_pages.py"))["notebook_page"](path)
    assert page.startswith("# A fit\n\nWords.\n\n[fit.ipynb](fit.ipynb)")
    assert "](../howto/run-a-notebook.md)" in page
    assert "```python\nprint(1)\n```\n\n```text\nbeta\n0.5\n```\n\n![What the cell draws](fit-0.png)" in page
    assert pictures == {"fit-0.png": png}


@pytest.mark.slow
@pytest.mark.parametrize("page", [*TUTORIALS, *HOWTO, *DEVELOPERS], ids=page_name)
def test_a_page_runs_as_typed(page: Path, tmp_path: Path) -> None:
    """Its blocks in their order, in an empty folder; `skip` marks a block that needs a device, a person or other data.
    A tutorial shows what its commands print."""
    run, came = 0, list[str]()
    for kind, about, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind == "toml" and about:
            (tmp_path / about.strip()).write_text(block, encoding="utf-8")
        commands = []
        if about.strip() != "skip":
            commands = [[sys.executable, "-c", block]] if kind == "python" else []
            commands = [["sh", "-c", line] for line in typed_lines(block)] if kind == "sh" else commands
        for command in commands:
            ended = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True)
            assert ended.returncode in ENDED, f"{command[-1]}: {ended.stderr[-2000:]}"
            run, came = run + 1, [*came, *ended.stdout.splitlines()]
        if kind == "text" and page in TUTORIALS:
            shown = [LEFT_OUT, *block.splitlines()]
            assert_same(page, shown, renewed(shown, came))
            came = []
    assert run >= 3 or page not in TUTORIALS


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))], ids=lambda page: page.stem)
def test_lines_to_type_are_shown_whole(page: Path) -> None:
    """Narrower than a block of the site and of GitHub, so that none is cut off."""
    typed = (block for kind, _, block in BLOCK.findall(page.read_text(encoding="utf-8")) if kind in TYPED)
    assert [line for block in typed for line in block.splitlines() if len(line) > WIDEST] == []


@pytest.mark.parametrize("page", [*HOWTO, *EXPLANATION], ids=page_name)
def test_a_page_is_short(page: Path) -> None:
    assert words(page) <= (OF_HOWTO if page in HOWTO else OF_EXPLANATION)


def test_all_pages_together_are_short() -> None:
    """Those of results are tables, which grow with what is measured."""
    assert sum(words(page) for page in DOCS.rglob("*.md") if page.parent.name != "results") <= OF_ALL


def test_addresses_of_before_lead_to_pages() -> None:
    plugins = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["plugins"]
    (maps,) = (one["redirects"]["redirect_maps"] for one in plugins if "redirects" in one)
    assert "exploring.md" in maps
    assert [new for new in maps.values() if not (DOCS / new).is_file()] == []
    assert [old for old in maps if (DOCS / old).exists()] == []


def test_notebooks_are_small_and_have_pictures() -> None:
    assert len(NOTEBOOKS) == 6
    for path in NOTEBOOKS:
        assert path.stat().st_size < 250_000
        assert '"image/png"' in path.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=page_name)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a kernel of its own, in an empty folder; each cell prints and draws what the one that ships does."""
    pytest.importorskip("ipykernel", reason="notebooks need pip install 'deformscope[notebooks]'")
    if path.stem == "foam-in-mujoco" and "DEFORMSCOPE_TARGETS_PYTHON" not in os.environ:
        pytest.importorskip("mujoco", reason="or DEFORMSCOPE_TARGETS_PYTHON, an interpreter with MuJoCo")
    client = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("MPLBACKEND", raising=False)  # the tests' own: a kernel draws into the notebook
    ships = nbformat.read(path, 4)
    notebook = nbformat.read(path, 4)
    client.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    for cell, before in zip(notebook.cells, ships.cells, strict=True):
        if cell.cell_type == "code":
            assert pictures(cell) == pictures(before), cell.source
            assert_same(path, printed_lines(before), printed_lines(cell))


def assert_same(path: Path, shown: Sequence[str], came: Sequence[str]) -> None:
    """Lines that a page shows are those that came; of devices in real time, the names of rows and no numbers."""
    if path.stem in IN_REAL_TIME:
        shown, came = ([row_of(NUMBER.sub("#", line)) for line in lines] for lines in (shown, came))
    assert len(shown) == len(came), came
    assert [f"- {a}\n+ {b}" for a, b in zip(shown, came, strict=True) if not is_same(a, b)] == []


def pictures(cell: Any) -> int:
    return sum("image/png" in one.get("data", {}) for one in cell.outputs)


def printed_lines(cell: Any) -> list[str]:
    """Without the lines that Open3D prints in a notebook when it is first imported."""
    lines = "".join(one["text"] for one in cell.outputs if one.get("name") == "stdout").splitlines()
    return [line for line in lines if "Open3D" not in line]


def test_messages_of_the_troubleshooting_page_are_the_programs() -> None:
    text = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    code = "".join(
        path.read_text(encoding="utf-8") for part in ("deformscope", "drivers") for path in (ROOT / part).rglob("*.py")
    )
    quoted = re.findall(r"^\| `(.*?)` \|", text, re.MULTILINE)
    assert len(quoted) > 20
    assert [one for one in quoted if f'"{one}' not in code] == []


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=page_name)
def test_sentences_are_short(page: Path) -> None:
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    prose = [line for line in text.splitlines() if not line.startswith(("#", "|", "!"))]
    sentences = [one for one in re.split(r"(?<=[.:?!])\s+|\n\n|\n- |\n\d\. ", "\n".join(prose)) if one.strip()]
    long = [one for one in sentences if len(one.split()) > LONGEST]
    assert len(long) <= (1 - SHARE) * len(sentences), long
