"""The files for a controller: nothing is held, corrections are relative and limited, and all of them agree."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from deformscope.cli import main
from deformscope_drivers.kuka import KukaConfig
from deformscope_drivers.kuka.config import FOLDER, TIMEOUT_S, controller_files
from deformscope_drivers.kuka.device import PROBE_DEG, PROBE_LEFT_OUT

AXES = [f"AK.A{axis}" for axis in range(1, 7)]
NAMES = ["deformscope.rsi", "deformscope.rsi.xml", "deformscope.src", "deformscope_ethernet.xml"]
VISUAL = "{http://schemas.microsoft.com/dsltools/RSIVisual}"


def controller_parameters(text: str) -> dict[tuple[str, str], str]:
    """(object, parameter) and value, as the controller reads them."""
    return {
        (one.attrib["ObjID"], parameter.attrib["Name"]): parameter.attrib["ParamValue"]
        for one in ET.fromstring(text)
        for parameter in one.iter("Parameter")
    }


def drawn_parameters(text: str) -> dict[tuple[str, str], str]:
    """As RSIVisual reads them."""
    return {
        (one.attrib["name"], parameter.attrib["name"]): parameter.attrib["value"]
        for one in ET.fromstring(text).iter(f"{VISUAL}rSIElement")
        for parameter in one.iter(f"{VISUAL}rSIParameter")
    }


def test_those_that_ship_are_those_of_the_documented_configuration() -> None:
    files = controller_files(KukaConfig(address="192.168.1.25"))
    assert sorted(files) == NAMES
    assert files == {path.name: path.read_text("utf-8") for path in FOLDER.iterdir()}


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
def test_they_say_what_the_driver_needs(cycle_s: float) -> None:
    config = KukaConfig(address="10.0.0.7", port=50000, sen_type="Other", cycle_s=cycle_s, joint_limit_deg_s=15.0)
    files = controller_files(config)
    ethernet = ET.fromstring(files["deformscope_ethernet.xml"])
    said = {name: ethernet.findtext(f"CONFIG/{name}") for name in ("IP_NUMBER", "PORT", "SENTYPE", "ONLYSEND")}
    assert said == {"IP_NUMBER": "10.0.0.7", "PORT": "50000", "SENTYPE": "Other", "ONLYSEND": "FALSE"}
    received = ethernet.findall("RECEIVE/ELEMENTS/ELEMENT")
    assert [(one.attrib["TAG"], one.attrib["HOLDON"]) for one in received] == [(axis, "0") for axis in AXES]
    sent = [one.attrib["TAG"] for one in ethernet.findall("SEND/ELEMENTS/ELEMENT")]
    assert {"DEF_AIPos", "DEF_RIst", "DEF_Delay", "DEF_MACur"} <= set(sent)
    parameters = controller_parameters(files["deformscope.rsi.xml"])
    assert parameters == drawn_parameters(files["deformscope.rsi"])
    assert parameters["ETHERNET1", "ConfigFile"] == "deformscope_ethernet.xml"
    for axis in range(1, 7):
        assert float(parameters[f"LIMIT{axis}", "UpperLimit"]) == pytest.approx(15.0 * cycle_s)
        assert float(parameters[f"LIMIT{axis}", "LowerLimit"]) == pytest.approx(-15.0 * cycle_s)
    assert PROBE_LEFT_OUT < int(parameters["ETHERNET1", "Timeout"]) == round(TIMEOUT_S / cycle_s)
    assert 10 ** -int(parameters["ETHERNET1", "Precision"]) < PROBE_DEG / 10
    modes = re.findall(r"RSI_ON\((.*)\)", files["deformscope.src"])
    assert modes == ["#RELATIVE, #IPO" if cycle_s == 0.012 else "#RELATIVE, #IPO_FAST"]
    assert 'RSI_CREATE("deformscope.rsi"' in files["deformscope.src"]


def test_every_correction_goes_through_its_limit() -> None:
    wires = {
        (one.attrib["ObjID"], wire.attrib["InIdx"]): (wire.attrib["OutObjID"], wire.attrib["OutIdx"])
        for one in ET.parse(FOLDER / "deformscope.rsi.xml").getroot()
        for wire in one.iter("Input")
    }
    for axis in "123456":
        assert wires["AXISCORR1", axis] == (f"LIMIT{axis}", "1")
        assert wires[f"LIMIT{axis}", "1"] == ("ETHERNET1", axis)


def test_the_command_writes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text('[devices.arm]\ndriver = "kuka"\naddress = "10.0.0.7"\n')
    assert main(["arm", "files", str(rig), "--out", str(tmp_path / "files")]) == 0
    assert sorted(path.name for path in (tmp_path / "files").iterdir()) == NAMES
    assert "no controller has run these files" in capsys.readouterr().err + capsys.readouterr().out
    rig.write_text('[devices.arm]\ndriver = "jaco"\n')
    assert main(["arm", "files", str(rig), "--out", str(tmp_path / "none")]) == 2
    assert not (tmp_path / "none").exists()
