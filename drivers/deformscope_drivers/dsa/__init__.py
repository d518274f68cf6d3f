"""The tactile sensors of Schunk's SDH, through their controller, a Weiss DSACON32m. The hand's motion is `sdh`."""

from deformscope_drivers.dsa.config import DsaConfig as DsaConfig
from deformscope_drivers.dsa.device import Dsa as Dsa
from deformscope_drivers.dsa.double import DsaDouble as DsaDouble
from deformscope_drivers.dsa.measurer import TactileReading as TactileReading
