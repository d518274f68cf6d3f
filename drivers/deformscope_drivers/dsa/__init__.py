"""The tactile sensors of Schunk's SDH, through their controller, a Weiss DSACON32m. The hand's motion is `sdh`."""

from deformscope_drivers.dsa.config import DsaConfig
from deformscope_drivers.dsa.device import Dsa, TactileReading
from deformscope_drivers.dsa.double import DsaDouble

__all__ = ["Dsa", "DsaConfig", "DsaDouble", "TactileReading"]
