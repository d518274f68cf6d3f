"""README and docs are true: short, linked, and with Python that runs."""

import json
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from deformscope.cli import COMMANDS
from tests.cases import Capture, Patch
from tests.cli.fake_bench import use_fake_bench

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES += [*sorted((ROOT / "drivers").glob("*.md")), ROOT / "recordings" / "README.md"]
BLOCK = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)


def page_name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def anchors(path: Path) -> set[str]:
    """What a link can lead to within a page, as GitHub names headings."""
    headings = re.findall(r"^#+ (.*)$", BLOCK.sub("", path.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in headings}


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").split()) <= 1200


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_links_lead_somewhere(page: Path) -> None:
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("http"):
            continue
        path, _, anchor = target.partition("#")
        if "reference/" in path:  # made as the site is built, which checks these links
            continue
        led = (page.parent / path).resolve() if path else page
        assert led.exists(), f"{page_name(page)} links {target}"
        assert not anchor or anchor in anchors(led), f"{page_name(page)} links {target}"


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_commands_exist(page: Path) -> None:
    groups = {name.split()[0] for name in COMMANDS if " " in name}
    for kind, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        for line in block.splitlines() if kind in ("", "console", "sh") else ():
            words = line.removeprefix("$ ").split()
            if words[:1] == ["deformscope"]:
                name = " ".join(words[1 : 3 if words[1] in groups else 2])
                assert name in COMMANDS or words[1] in COMMANDS, f"{page_name(page)}: {line}"


@pytest.mark.parametrize("page", sorted((ROOT / "drivers").glob("*.md")), ids=page_name)
def test_code_of_drivers_names_what_exists(page: Path) -> None:
    """Devices are not here, so its blocks are compiled, and of what they run only the imports."""
    for kind, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind == "python":
            compile(block, str(page), "exec")
            exec("\n".join(line for line in block.splitlines() if line.startswith("from ")), {})


def test_a_page_shows_how_every_command_is_used() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert [name for name in COMMANDS if not re.search(rf"(?:deformscope |`){name}[` \n]", text)] == []


def test_walks_name_files_that_exist() -> None:
    page = (ROOT / "docs" / "developers" / "architecture.md").read_text(encoding="utf-8")
    section = re.split(r"^## ", page.split("## Six walks\n")[1], flags=re.MULTILINE)[0]
    walks = section.split("### ")[1:]
    assert len(walks) == 6
    for walk in walks:
        files = re.findall(r"^\d+\. `(.+?)`: \w", walk, re.MULTILINE)
        assert [name for name in files if not (ROOT / name).is_file()] == []
        assert len(files) >= 10


def test_walks_pass_no_more_than_the_page_says() -> None:
    """As the tracer counts them. It finds every file that the page names for the depth frame."""
    tool = runpy.run_path(str(ROOT / "tools" / "walks.py"))
    page = (ROOT / "docs" / "developers" / "architecture.md").read_text(encoding="utf-8")
    stated = re.findall(r"^\| ([a-z ]+) \| [^|]+ \| (\d+) \| (\d+) \| (\d+) \|", page, re.MULTILINE)
    assert [name for name, *_ in stated] == list(tool["WALKS"])
    for name, *most in stated:
        walk = tool["walked"](name)
        assert [(one, bound) for one, bound in zip(walk.counts, map(int, most), strict=False) if one > bound] == [], (
            name
        )
    named = re.findall(r"^\d+\. `(.+?)`: ", page.split("### From a depth frame")[1].split("###")[0], re.MULTILINE)
    assert set(named) <= set(walk.files)


@pytest.mark.parametrize(
    ("body", "counts"),
    [
        ("c.keep(a)", (1, 1, 0, 1)),  # nothing that is known
        ("helper(a)\n    helper(a)", (1, 1, 0, 2)),  # in the same file, once
        ("there.one(a)\n    helper(a)\n    there.two(a.part)", (4, 2, 2, 4)),
        ("there.one(1)", (1, 1, 0, 1)),  # without the datum
        ("b = a + 1\n    there.one(key=b)", (2, 2, 0, 2)),
        ("submit(there.one, a)", (2, 2, 0, 2)),  # handed on
        ("there.Box(a).opened(a)", (2, 2, 0, 3)),
    ],
)
def test_the_tracer_counts_what_a_datum_is_given_to(
    body: str, counts: tuple[int, ...], tmp_path: Path, monkeypatch: Patch
) -> None:
    tool = runpy.run_path(str(ROOT / "tools" / "walks.py"))
    monkeypatch.setitem(tool["walked"].__globals__, "ROOT", tmp_path)
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "here.py").write_text(
        f"from pack import there\n\ndef helper(x): ...\n\ndef run(a, c):\n    {body}\n"
    )
    (tmp_path / "pack" / "there.py").write_text(
        "def one(key): ...\n\ndef two(key): ...\n\nclass Box:\n"
        "    def __init__(self, x): ...\n    def opened(self, x): ...\n"
    )
    assert tool["walked"]("pack/here.py run a").counts == counts


@pytest.mark.parametrize("scene", ["in a moment", pytest.param("simulated", marks=pytest.mark.slow)])
def test_the_readmes_python_runs(scene: str, capsys: Capture, monkeypatch: Patch) -> None:
    """Unchanged, on a bench that is explored in a moment; or on the scene itself, with fewer touches. And an
    exploration's result is what the library says it is."""
    pytest.importorskip("warp")
    (script,) = (block for kind, block in BLOCK.findall(README.read_text(encoding="utf-8")) if kind == "python")
    assert len([line for line in script.splitlines() if line]) <= 12
    touches = 8
    if scene == "simulated":
        touches = 2
        few = script.replace("touches=8", f'touches={touches}, beta_model="none"')
        assert few != script
        script = few
    else:
        use_fake_bench(monkeypatch)
    names: dict[str, Any] = {}
    exec(compile(script, "README.md", "exec"), names)
    out, err = capsys.readouterr()
    assert out.startswith("beta of sample:poke\n")
    assert "\n2.17 N/mm under the tip (1.99 to 2.35)\n" in out
    assert "\nlab:two-60-150\n  verdict " in out
    assert out.endswith(f", {touches} touches\n")
    assert err == ""
    table = names["table"]
    assert table.stiffness_n_per_mm.shape == table.labels.shape
    told = table.to_dict()
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert table._repr_html_().count("<img") == 1
