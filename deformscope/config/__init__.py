"""The options of each command: one frozen dataclass per command, whose fields are its flags.

A field's docstring is the flag's help. A single value is checked where it is parsed (`ValueError`, which the command
line reports with the flag's name). A `Rule` in the annotation limits its range; the dataclass's `check` compares values
with one another (`InputError`). Nothing heavy is imported here: `--help` shows these classes.
"""

from deformscope.config.arm import FilesConfig, GoConfig, HomeConfig, JogConfig, MovingOptions, WhereConfig
from deformscope.config.calibrate import (
    AxesConfig,
    BetaConfig,
    FieldConfig,
    MaterialOptions,
    PredictConfig,
    SearchOptions,
    SummaryOptions,
    ThetaConfig,
    ViscousConfig,
    YieldConfig,
)
from deformscope.config.classify import ClassifyConfig
from deformscope.config.executor import CatalogConfig, CompareConfig, SweepConfig
from deformscope.config.explore import ExploreConfig
from deformscope.config.flags import PokeText, parse_poke, parse_pokes
from deformscope.config.images import FlowConfig, ImageOptions
from deformscope.config.indent import IndentConfig
from deformscope.config.options import CommandOptions, OutputOptions, RecordedOptions
from deformscope.config.rigs import (
    ArmConfig,
    BenchConfig,
    CertifyConfig,
    DemoConfig,
    DevicesConfig,
    DiscardRecordingConfig,
    DoctorConfig,
    DoubleConfig,
    ExportConfig,
    ImportConfig,
    LiveConfig,
    NewDeviceConfig,
    NewRigConfig,
    RecordConfig,
    RecoverConfig,
    ReplayConfig,
    ReportConfig,
    RigRunOptions,
    VerifyConfig,
    WrenchConfig,
)
from deformscope.config.setup import (
    CameraConfig,
    ForceConfig,
    PlaceConfig,
    SetupOptions,
    TimeConfig,
    TipConfig,
    ToolConfig,
)
from deformscope.config.simulate import SimulateConfig
from deformscope.config.squeeze import (
    DatasetConfig,
    DiscardConfig,
    MergeConfig,
    RelabelConfig,
    RepairConfig,
    SqueezeConfig,
)
