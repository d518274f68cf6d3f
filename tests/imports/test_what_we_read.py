"""The page of what is read names what the code reads by."""

import runpy
from pathlib import Path

from deformscope.imports.frame_builder import STANDARD
from deformscope.imports.image_messages import COLOR_ENCODINGS, DEPTH_ENCODINGS
from deformscope.imports.readers import BAGS, FILES, TABLES

PAGES = runpy.run_path(str(Path(__file__).resolve().parents[2] / "tools" / "reference_pages.py"))


def test_the_page_names_every_type_encoding_and_ending() -> None:
    page = PAGES["what_we_read"]()
    names = [*STANDARD, *DEPTH_ENCODINGS, *COLOR_ENCODINGS, *BAGS, *FILES, *TABLES]
    assert [name for name in names if name.rpartition("/")[2] not in page] == []


def test_every_row_says_how_unit_frame_and_clock_are_known() -> None:
    head, rows = PAGES["READ_HEAD"], PAGES["read_rows"]()
    assert {len(row) for row in rows} == {len(head)}
    assert [row for row in rows if not all(row[:2])] == []


def test_brackets_are_escaped_outside_of_code_alone() -> None:
    assert PAGES["_escaped"]("[a] is `[b] c<d` <e> [f](g)") == "\\[a] is `[b] c<d` &lt;e> [f](g)"
    assert "\\[" not in "".join(PAGES["rig_file"]().split("`")[1::2])
