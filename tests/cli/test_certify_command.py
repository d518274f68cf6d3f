"""`certify`: a simulated rig with hidden errors on a known block, its certificate in the rig file, and what uses it."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import deformscope as ds
from deformscope.cli import main
from deformscope.config import CertifyConfig
from deformscope.lab.scenes import built_in
from deformscope.lab.session_errors import LabErrors
from deformscope.recording.reader import Replay
from deformscope.rig.rig_file import load_rig, parse_rig
from deformscope.rig.sections import CertificateSection
from deformscope.runs.arm_calibration import known_sample, opening_of
from tests.cases import Capture, Patch, one_line
from tests.cli.quick_scene import use_quick_scene
from tests.cli.rig_on_a_simulated_clock import use_a_simulated_clock
from tests.cli.test_explore_rig import RIG
from tests.verified import verify_here

BLOCK = RIG.replace('"two-60-150"', '"block-162"')
CERTIFICATE = """
[certificate]
date = 2026-01-02
sample = "ecoflex-00-30"
tip = "sphere of 20 mm"
bias = 0.21
interval = [0.1, 0.331]
causes = {"force gain" = [0.09531018, 0.02], "compliance" = [1e-4, 1e-5], "clock" = [0.004, 0.001]}
"""


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rig.toml"
    path.write_text(BLOCK)
    return path


@pytest.mark.slow  # a rig file below is certified and replayed by the same lines
def test_a_hidden_rig_has_its_bias_in_the_interval(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    """Nothing of what was drawn reaches the result but by the touches; the recording has it beside."""
    found, recording = tmp_path / "found.json", tmp_path / "c.rrd"
    flags = ["--sample", "lab-block", "--seed", "8", "--touches", "2", "--viewer", "none"]
    assert main(["certify", "lab:block-162", *flags, "--json", str(found), "--record", str(recording)]) == 0
    drawn = LabErrors.uncertified().draw([8, built_in("block-162", 8).seed])
    told, scene = json.loads(found.read_text()), built_in("block-162", 8)
    bias = told["read_pa"] / float(scene.modulus_pa(np.array([0.3, 0.2]))) - 1.0
    low, high = told["bias_interval"]
    assert low < bias < high
    assert drawn.gain == pytest.approx(1.147, abs=0.001)  # what is to be found
    assert low > 0.05
    shown = capsys.readouterr().out
    section = tomllib.loads(shown[shown.index("[certificate]") :])["certificate"]
    assert CertificateSection(**section).interval == pytest.approx([low, high])
    assert Replay(recording).settings["laboratory"]["drawn"]["gain"] == drawn.gain
    assert verify_here(recording) == 0
    assert main(["replay", str(recording)]) == 0
    assert "the certificate computed again from its touches, identical" in capsys.readouterr().err
    page = tmp_path / "page.html"
    assert main(["report", str(recording), "--out", str(page)]) == 0
    assert "holds  certificate of lab:block-162: bias +" in capsys.readouterr().out
    assert "Force over depth of each touch, with the law" in page.read_text()
    monkeypatch.setattr("deformscope.stages.poke.certificate.OFF_SHARE", 0.3)
    assert main(["replay", str(recording)]) == 2
    assert "another bias of RigBias" in capsys.readouterr().err
    assert main(["catalog", "compare", str(recording), str(recording), "--json", str(found)]) == 0
    assert "certificates" not in json.loads(found.read_text())


def test_a_rig_file_gets_its_certificate(rig: Path, tmp_path: Path, monkeypatch: Patch) -> None:
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    touched = tmp_path / "touched.rrd"
    found = ds.certify(rig, sample="lab-block", thickness_m=0.05, touches=1, save=True, record=touched)
    made = load_rig(rig).certificate
    assert made is not None
    assert (made.sample, made.tip, made.days) == ("lab-block", "sphere of 20 mm", 0)
    assert made.bias == pytest.approx(found.to_dict()["bias"], rel=1e-6)
    assert "modulus read" in str(found)
    assert "a recipe's modulus is of one laboratory" in str(found)
    replayed = ds.replay(touched)
    assert "the certificate computed again from its touches, identical to the recorded one" in str(replayed)
    bytes_of = {one["device"]: one["compared"] for one in replayed.to_dict()["devices"]}
    assert bytes_of["tip"] > 100


@pytest.mark.slow  # two explorations; what is corrected, and by how much, is tested below and in tests/stages/poke
def test_explore_and_compare_use_the_certificate_of_a_rig_file(
    rig: Path, tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    use_a_simulated_clock(monkeypatch)
    use_quick_scene(monkeypatch)
    rig.write_text(BLOCK + CERTIFICATE)
    plain, corrected, told = tmp_path / "a.rrd", tmp_path / "b.rrd", tmp_path / "told.json"
    stiff = []
    for path, more in ((plain, []), (corrected, ["--corrected"])):
        flags = ["--touches", "1", "--beta-model", "none", "--record", str(path), "--json", str(told)]
        assert main(["explore", str(rig), *flags, *more]) == 0, capsys.readouterr().err
        stiff.append(json.loads(told.read_text())["touches"][0]["apparent_stiffness_n_per_mm"])
        certificate = json.loads(told.read_text())["certificate"]
        assert certificate.startswith("this rig read +21.0 % (+10.0 to +33.1) on ecoflex-00-30")
        assert certificate.endswith("taken out") == bool(more)
    # less force by a tenth, which at a set force is 10^(2/3) percent, and more of the depth is the arm's
    assert 0.85 * stiff[0] < stiff[1] * 1.1 ** (2 / 3) / (1.0 + 1e-4 * 1e3 * stiff[1]) < 1.15 * stiff[0]
    assert stiff[1] != stiff[0]
    results = []
    for more in ([], ["--corrected"]):
        capsys.readouterr()
        assert main(["catalog", "compare", str(plain), str(corrected), *more, "--json", str(told)]) == 0
        compared = json.loads(told.read_text())
        assert len(compared["certificates"]) == 2
        results.append(next(one for one in compared["results"] if one["name"] == "stiffness"))
    assert results[1]["first"]["value"] == pytest.approx(results[0]["first"]["value"] / 1.21 ** (2 / 3))
    assert results[1]["second"] == results[0]["second"]  # that map was corrected as it was made
    widths = [np.diff(np.log(one["first"]["interval"])) for one in results]
    assert widths[1] == pytest.approx(widths[0] + 2 / 3 * np.log(1.331 / 1.1))


def test_without_a_certificate_nothing_is_corrected(rig: Path, capsys: Capture) -> None:
    assert main(["explore", str(rig), "--corrected"]) == 2
    assert "certify RIG" in one_line(capsys)
    assert main(["explore", "lab:two-60-150", "--corrected"]) == 2
    assert "a rig file with a [certificate]" in one_line(capsys)
    rig.write_text(BLOCK + CERTIFICATE.replace("20 mm", "6 mm"))
    assert main(["explore", str(rig), "--corrected"]) == 2
    assert "a certificate of this tip, a sphere of 20 mm; got of a sphere of 6 mm" in one_line(capsys)


def test_what_a_certificate_found_is_taken_out_of_the_rig() -> None:
    rig = parse_rig(BLOCK + CERTIFICATE, "rig")
    found = rig.corrected()
    assert found.tool.force_gain == pytest.approx(1.1)
    assert found.tool.force_gain_sd == pytest.approx(np.log(1.331 / 1.1) / 3.29)
    assert found.tool.compliance_m_per_n == pytest.approx(3e-4)
    assert found.tool.radius_m == rig.tool.radius_m
    assert [one.late_ns for one in found.devices if one.driver.kind == "wrench"] == [4_000_000]


@pytest.mark.parametrize(
    ("change", "word", "says"),
    [
        (("", ""), "look", "old; certify again"),
        (("date = 2026-01-02", "date = 2999-01-02"), "ok", ", 0 days ago"),
        (('20 mm"', '6 mm"'), "look", "of another tip, a sphere of 6 mm"),
    ],
)
def test_doctor_says_when_a_certificate_is_old_or_of_another_tip(
    change: tuple[str, str], word: str, says: str, rig: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    monkeypatch.setattr("deformscope.cli.doctor._device", lambda *_: [])
    rig.write_text(BLOCK + CERTIFICATE.replace(*change))
    main(["doctor", str(rig)])
    (line,) = [one for one in capsys.readouterr().out.splitlines() if "this rig read" in one]
    assert line.startswith(word)
    assert says in line


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--sample", "ecoflex-00-31"], "try: ecoflex-00-30"),
        (["--sample", "none.json"], "the JSON of deformscope indent"),
        (["--sample", "rig.json"], "the JSON of deformscope indent"),
        (["--sample", "text.json"], "the JSON of deformscope indent"),
        (["--sample", "lab-block", "--thickness-m", "50"], "a --thickness-m below 1 m"),
        (["--sample", "lab-block", "--save"], "a rig file, to --save into"),
        (["--sample", "ecoflex-00-10-thinner-50", "--thickness-m", "0.002"], "a firmer or a thicker one"),
        (["--sample", "lab-block", "--touches", "0"], "--touches"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    arguments: list[str], says: str, rig: Path, capsys: Capture
) -> None:
    Path("rig.json").write_text('{"together": null, "curves": [{"modulus_pa": -3}], "settings": {}}')
    text = '{"curves": [{"modulus_pa": 3, "modulus_interval_pa": [2, 4]}], "together": null, "settings": %s}'
    Path("text.json").write_text(text % '{"poisson": [0.3, 0.5], "thickness_m": "thick"}')
    assert main(["certify", "lab:block-162", *arguments]) == 2
    assert says in one_line(capsys)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("date = 2026-01-02", "date = YEAR-MONTH-DAY"),
        ("interval = [0.1, 0.331]", "bias within its interval"),
        ('sample = "ecoflex-00-30"', "sample"),
    ],
)
def test_a_certificate_that_is_none_is_refused(line: str, says: str, rig: Path, capsys: Capture) -> None:
    wrong = {"date": "date = 3", "interval": "interval = [0.3, 0.331]", "sample": "samples = 1"}[line.split(" =")[0]]
    rig.write_text(BLOCK + CERTIFICATE.replace(line, wrong))
    assert main(["doctor", str(rig)]) == 2
    assert says.split(" ")[0] in one_line(capsys)


@pytest.mark.parametrize(
    ("name", "kpa", "sd"), [("ecoflex-00-50-thinner-12.5", 111.1, 6.44), ("ecoflex-00-10-thinner-100", 5.42, 0.77)]
)
def test_a_named_sample_has_its_modulus(name: str, kpa: float, sd: float) -> None:
    config = CertifyConfig.of(rig="lab:block-162", sample=name)
    known = known_sample(config, opening_of(config))
    assert (known.name, known.modulus_pa, known.modulus_sd) == (name, pytest.approx(1e3 * kpa), pytest.approx(sd / kpa))


def test_the_block_is_listed(capsys: Capture) -> None:
    assert main(["explore", "--list-scenarios"]) == 0
    assert "lab:block-162              hardness 0.98 to 1.02" in capsys.readouterr().out


def test_a_sample_may_be_the_result_of_indent(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.chdir(tmp_path)
    time = np.arange(0, 12, 0.02)
    depth_mm = 3 - np.abs(time - 6) / 2
    force_n = 4 / 3 * 20e3 / 0.75 * 0.1 * np.clip((depth_mm - 1) / 1000, 0, None) ** 1.5
    rows = np.column_stack([time, depth_mm, force_n + 0.001 * np.random.default_rng(1).standard_normal(len(time))])
    np.savetxt("poke.csv", rows, delimiter=",", header="time [s],depth [mm],force [N]", comments="")
    flags = ["--tip", "sphere:0.02", "--poisson", "0.48,0.5", "--thickness-m", "0.03", "--sliding"]
    assert main(["indent", "poke.csv", *flags, "--json", "sample.json"]) == 0
    config = CertifyConfig.of(rig="lab:block-162", sample="sample.json")
    known = known_sample(config, opening_of(config))
    assert (known.lies.ground, known.lies.thickness_m, known.lies.poisson) == ("sliding", 0.03, (0.48, 0.5))
    assert known.modulus_pa == pytest.approx(18e3, rel=0.1)
    assert 0.005 < known.modulus_sd < 0.1
