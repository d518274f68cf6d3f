"""Options of `deformscope simulate`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config import flags
from deformscope.config.indent import TipText, parse_tip
from deformscope.config.options import RecordedOptions, ViewOptions, either
from deformscope.errors import InputError

Target = Literal["mujoco", "newton"]
PythonFlag = Annotated[Path | None, flags.one_word("PYTHON", Path), flags.unset]
TipFlag = Annotated[TipText | None, flags.one_word("KIND:SIZE", parse_tip), flags.unset]
_step = flags.Rule(lambda value: 0.0 < value <= 0.1, "a {flag} above 0, up to 0.1")
_ratio = flags.Rule(lambda value: 0.0 <= value < 0.5, "a {flag} of 0 to below 0.5")


@dataclass(frozen=True, slots=True)
class SimulateConfig(RecordedOptions):
    """Write a measured slab as a body of another simulator, press it there as it was pressed, and fit that simulator's
    own parameters until force and dent agree. Pokes that are held out test it."""

    source: Annotated[Path, Positional, arg(metavar="MODEL.npz|FILE.rrd"), flags.Reads()]
    """A model of layers that `deformscope calibrate ... --save` wrote, or the recording of an exploration or a pair."""
    target: Annotated[Target, arg(name="in")]
    """The simulator. It must be installed: pip install mujoco, or newton usd-core
    newton-usd-schemas."""
    out: flags.Folder
    """Folder for the body: the simulator's own file, and VTU and OBJ for others."""
    python: PythonFlag = None
    """The Python interpreter with the simulator; default: this one."""
    against: Annotated[tuple[Path, ...], arg(metavar="PAIR.npz..."), flags.Reads()] = ()
    """Measured pokes of the model's surface, with their force."""
    poke: flags.PokesFlag = ()
    """Pokes that the model predicts, as in `deformscope predict`: in place of measured ones, or as the test of a fit to
    those of --against."""
    tip: TipFlag = None
    """For a recording: sphere:DIAMETER, disc:DIAMETER or flat:AxB in metres."""
    thickness_m: flags.PositiveFlag = None
    """For a recording: thickness of the foam, which is glued to the ground [m]; default: as its touches found it."""
    held_out: Annotated[flags.CountFlag, flags.least(0)] = None
    """Pokes that are not fitted, but test the fit; default: a third of them."""
    poisson: Annotated[float | None, flags.one_word("NU", float), flags.unset, _ratio] = None
    """Poisson's ratio; default: fitted."""
    vertices: Annotated[int, flags.least(48)] = 2400
    """About how many vertices the body has."""
    spacing_m: flags.PositiveFlag = None
    """Size of its cells [m], in place of --vertices."""
    reach_m: flags.PositiveFlag = None
    """How far it goes beyond a tip [m]; default: its thickness and 0.45 of the tip."""
    density: Annotated[float, flags.Rule(lambda value: value > 0.0, "a {flag} above 0")] = 100.0
    """Density [kg/m^3]: a simulator's contact can depend on it."""
    timestep_s: Annotated[float | None, flags.one_word("SECONDS", float), flags.unset, _step] = None
    """Time step [s]; default: 0.005 for MuJoCo, 0.001 for Newton."""
    limit_s: Annotated[float, flags.Rule(lambda value: value > 0.0, "a {flag} above 0")] = 1800.0
    """Time limit [s], after which the best fit so far is the result."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    @property
    def recorded(self) -> bool:
        return self.source.suffix.lower() == ".rrd"

    def check(self) -> None:
        either("--held-out", "--against with --poke", self.held_out, self.against and self.poke)
        either("--spacing-m", "--vertices", self.spacing_m, self.vertices != 2400)
        if self.recorded and (self.against or self.poke):
            raise InputError("a model with --against or --poke", "a recording, which has its own pokes")
        if not self.recorded and not (self.against or self.poke):
            raise InputError("pokes of the model's surface", "none", "--against PAIR.npz..., or --poke")
        if self.tip is not None and not self.recorded:
            raise InputError("--tip with a recording", "with a model, whose pokes have theirs")
        if self.tip is not None and self.tip.kind == "cone":
            raise InputError("a sphere, a disc or a flat tip", "a cone")
