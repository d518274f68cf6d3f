"""Tables of labelled trials in every format, and what is refused of them in one line."""

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet

from deformscope.errors import InputError
from deformscope.files.table_file import read_table
from tests.stages.squeeze.trials import two_modalities


def columns() -> dict[str, object]:
    table = two_modalities()
    found: dict[str, object] = {"label": table.label.tolist(), "group": table.group.tolist()}
    for name, values in table.modalities.items():
        for column in reversed(range(values.shape[1])):  # their numbers count, not where they stand
            found[f"{name}.{column}"] = values[:, column]
    return found


@pytest.mark.parametrize("kind", ["npz", "csv", "parquet"])
def test_every_format_gives_the_same_table(tmp_path: Path, kind: str) -> None:
    wanted = two_modalities()
    path = tmp_path / f"table.{kind}"
    if kind == "npz":
        np.savez(path, label=wanted.label, group=wanted.group, **wanted.modalities)  # type: ignore[arg-type]
    elif kind == "csv":
        csv.write_csv(pa.table(columns()), path)
    else:
        parquet.write_table(pa.table(columns()), path)
    found = read_table(path)
    np.testing.assert_array_equal(found.label, wanted.label)
    np.testing.assert_array_equal(found.group, wanted.group)
    assert set(found.modalities) == {"touch", "vision"}
    for name, values in wanted.modalities.items():
        np.testing.assert_allclose(found.modalities[name], values, rtol=1e-12)


def test_arrays_of_any_shape_numbers_as_labels_and_series(tmp_path: Path) -> None:
    path = tmp_path / "table.npz"
    frames = np.arange(24.0, dtype=np.float32).reshape(4, 3, 2)
    np.savez(path, label=np.array([1, 2, 1, 2]), pads=frames, **{"series.pads": frames}, step_s=0.05)  # type: ignore[arg-type]
    found = read_table(path)
    assert found.classes == ("1", "2")
    assert found.group is None
    np.testing.assert_array_equal(found.modalities["pads"], frames.reshape(4, 6))
    np.testing.assert_array_equal(found.series["pads"], frames)
    assert found.step_s == 0.05


def test_empty_fields_of_a_csv_were_not_measured(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("label,trial,f.0,f.1\nNA,t1,1,\nb,t2,2,5\nb,t3,NaN,6\n")
    found = read_table(path)
    assert found.classes == ("NA", "b")
    np.testing.assert_array_equal(found.modalities["f"], [[1, np.nan], [2, 5], [np.nan, 6]])


def npz(**arrays: object) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


LABEL = np.array(["a", "b"])
REFUSED = {
    "none.npz": (None, "got no such file"),
    "text.npz": (b"hello", "a damaged file"),
    "cut.npz": (npz(label=LABEL, f=np.eye(2))[:200], "a damaged file"),
    "unlabelled.npz": (npz(f=np.eye(2)), "`label` in the table; got f"),
    "objects.npz": (npz(label=np.array(["a", None], dtype=object), f=np.eye(2)), "Python objects (pickle)"),
    "short.npz": (npz(label=LABEL, f=np.eye(3)), "2 rows of features in f"),
    "texts.npz": (npz(label=LABEL, note=LABEL), "numbers in note"),
    "numbered.npz": (npz(label=LABEL, f=np.eye(2), row=np.arange(2)), "call it trial, group or kind"),
    "halves.npz": (npz(label=np.array([0.5, 1.0]), f=np.eye(2)), "whole numbers in label"),
    "alone.npz": (npz(label=LABEL), "at least one modality"),
    "number.npz": (npz(label=LABEL, f=np.eye(2), depth=3.0), "a row of depth for each label"),
    "table.doc": (b"label", "ends in .npz, .csv, .tsv, .txt, .dat, .parquet; got '.doc'"),
    "no.csv": (b"", "a CSV table with a header"),
    "ragged.csv": (b"label,f.0\na,1\nb,2,3\n", "a CSV table with a header"),
    "unnamed.csv": (b"label,f.0,force\na,1,2\nb,2,3\n", "got force"),
    "gap.csv": (b"label,f.0,f.2\na,1,2\nb,2,3\n", "no f.1"),
    "words.csv": (b"label,f.0\na,soft\nb,hard\n", "numbers in column f.0"),
    "unlabelled.csv": (b"f.0\n1\n2\n", "a column `label`; got f.0"),
    "blank.csv": (b"label,f.0\na,1\n,2\n", "a label in every row"),
    "none.parquet": (b"PAR1 and more", "a Parquet table"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_table_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    content, said = REFUSED[name]
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as refusal:
        read_table(path)
    assert said in str(refusal.value)
    assert str(refusal.value).endswith(str(path))
    assert "\n" not in str(refusal.value)


def test_a_folder_is_no_table(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="got a folder"):
        read_table(tmp_path)
