"""The options of each command: one frozen dataclass a command, whose fields are its flags.

A field's docstring is the flag's help. What one value must look like is checked where it is parsed (`ValueError`, which
the command line reports with the flag's name), what values must satisfy together where the dataclass is made
(`InputError`). Nothing heavy is imported here: `--help` shows these classes.
"""

from __future__ import annotations

from deformscope.config.bench import BenchConfig
from deformscope.config.calibrate import (
    AxesConfig,
    BetaConfig,
    BothConfig,
    PredictConfig,
    SearchOptions,
    SummaryOptions,
    ThetaConfig,
    YieldConfig,
)
from deformscope.config.classify import ClassifyConfig
from deformscope.config.flags import PokeText, parse_poke, parse_pokes
from deformscope.config.images import FlowConfig, ImageOptions
from deformscope.config.options import CommandOptions, OutputOptions, RecordedOptions, Written
from deformscope.config.reproduce import (
    ContainersConfig,
    CoverageConfig,
    CubesConfig,
    FoamsConfig,
    PokesConfig,
    Table41Config,
)
from deformscope.config.rigs import (
    ArmConfig,
    DevicesConfig,
    DoctorConfig,
    DoubleConfig,
    ExploreConfig,
    ExportConfig,
    LiveConfig,
    RecordConfig,
    RecoverConfig,
    RigRunOptions,
    VerifyConfig,
)
from deformscope.config.runs import DemoConfig, ReplayConfig
from deformscope.config.squeeze import (
    DatasetConfig,
    DiscardConfig,
    MergeConfig,
    RelabelConfig,
    RepairConfig,
    SqueezeConfig,
)

__all__ = [
    "ArmConfig",
    "AxesConfig",
    "BenchConfig",
    "BetaConfig",
    "BothConfig",
    "ClassifyConfig",
    "CommandOptions",
    "ContainersConfig",
    "CoverageConfig",
    "CubesConfig",
    "DatasetConfig",
    "DemoConfig",
    "DevicesConfig",
    "DiscardConfig",
    "DoctorConfig",
    "DoubleConfig",
    "ExploreConfig",
    "ExportConfig",
    "FlowConfig",
    "FoamsConfig",
    "ImageOptions",
    "LiveConfig",
    "MergeConfig",
    "OutputOptions",
    "PokeText",
    "PokesConfig",
    "PredictConfig",
    "RecordConfig",
    "RecordedOptions",
    "RecoverConfig",
    "RelabelConfig",
    "RepairConfig",
    "ReplayConfig",
    "RigRunOptions",
    "SearchOptions",
    "SqueezeConfig",
    "SummaryOptions",
    "Table41Config",
    "ThetaConfig",
    "VerifyConfig",
    "Written",
    "YieldConfig",
    "parse_poke",
    "parse_pokes",
]
