"""Constants of the laboratory's containers, contents, fingertips and sensors, each with its source.

The constants were fixed before any classifier ran on data of this laboratory, and must not be tuned to classifiers'
results. "Assumed" marks a value without an available measurement; its size is plausible and its effect is described.

Sources:
  CRC       Handbook of Chemistry and Physics (water, air at 20 degC and 101.3 kPa)
  EN1991-4  Eurocode 1, part 4: Silos and tanks (2006), annexes C (effective modulus) and E (properties of bulk solids)
  GUAN      Guan and Zhang 2009, J. Food Engineering 94: internal friction and cohesion of wheat flour
  KIBAR     Kibar, Ozturk and Esen 2010, Spanish J. Agricultural Research 8(3): rice at 10 to 14 % moisture
  LANZER    Lanzerstorfer 2020, J. Food Engineering 276: density of food powders = a (stress / 1 kPa)^b
  DST       Dairy Science and Technology 89 (2009), dst0909, table VI: low-fat yogurts, Herschel-Bulkley fits
  DIMONTE   Dimonte et al. 1998, J. Rheology 42(4): 727: yogurt is elastic below a finite yield stress
  XIA       Xia, Boyce and Parks 2002, Int. J. Solids and Structures 39: elastic constants of paperboard
  PODDAR    Poddar, Andreasson and Nygards 2024, Nordic Pulp and Paper Research J.: modulus against strain rate
  CRAWFORD  Crawford, Plastics Engineering, 3rd ed.: high-density polyethylene
  ROS       package schunk_simulated_tactile_sensors: "measurement range 250 kPa (from the data sheet)", output up to
            about 3500 "by experiment from the real SDH"
  ROBWORK RobWorkData (University of Southern Denmark; skyellen/robwork-mirror at a05f4ea),
            devices/hands/SchunkHandV2/SchunkHandTactile6.dwc.xml. It is a simulated SDH with force limits of 2.1 Nm in
            the proximal joints and 1.4 Nm in the distal ones, and pads to 250 kPa; Schunk's own catalogue was not
            available
  KHOSH     Khoshelham and Oude Elberink 2012, Sensors 12: depth noise of a first Kinect"""

from dataclasses import dataclass
from typing import Final

GRAVITY_M_S2: Final = 9.81
AIR_PRESSURE_PA: Final = 101_325.0
ROOM_K: Final = 293.15

# Contents -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Content:
    """Content of a container, as `container_world` uses it. Zeros mean that there is no such resistance.

    density_kg_m3: bulk density; solid_share: share of solid of the filled volume that is no gas; lateral_ratio:
    horizontal over vertical stress at rest
    friction_deg, cohesion_pa: friction and cohesion of Coulomb's law, for granular contents
    load_modulus, unload_modulus: confined modulus over stress, on first loading and after, for granular contents
    shear_modulus_pa, yield_pa, consistency_pa_sn, flow_index: elasticity below yield, and stress = yield + consistency
    rate^index above it (Herschel-Bulkley), for fluids; a Newtonian liquid has index 1 and no yield"""

    density_kg_m3: float
    solid_share: float
    lateral_ratio: float
    friction_deg: float = 0.0
    cohesion_pa: float = 0.0
    load_modulus: float = 0.0
    unload_modulus: float = 0.0
    shear_modulus_pa: float = 0.0
    yield_pa: float = 0.0
    consistency_pa_sn: float = 0.0
    flow_index: float = 1.0


EMPTY: Final = Content(density_kg_m3=1.204, solid_share=0.0, lateral_ratio=0.0)  # CRC

WATER: Final = Content(
    density_kg_m3=998.2,  # CRC
    solid_share=1.0,
    lateral_ratio=1.0,
    shear_modulus_pa=1e3,  # none: in series with the viscosity it relaxes within microseconds; for the solver
    consistency_pa_sn=1.002e-3,  # CRC
)

YOGURT: Final = Content(
    density_kg_m3=1030.0,  # assumed: that of milk with a little more dry matter
    solid_share=1.0,
    lateral_ratio=1.0,
    shear_modulus_pa=400.0,  # assumed, for stirred yogurt; DIMONTE finds an elastic range below yield
    yield_pa=15.28,  # DST, control after 14 days; 8 to 28 Pa over 28 days
    consistency_pa_sn=2.33,  # DST, the same
    flow_index=0.65,  # DST, the same
)

FLOUR: Final = Content(
    density_kg_m3=660.0,  # EN1991-4 table E.1: 6.5 kN/m3
    solid_share=0.46,  # density over 1450 kg/m3 of the particles (starch; assumed)
    lateral_ratio=0.36,  # EN1991-4 table E.1
    friction_deg=37.6,  # GUAN
    cohesion_pa=300.0,  # assumed: loosely filled, hardly consolidated; GUAN finds it to grow with consolidation
    load_modulus=17.0,  # 1 / b of LANZER's power law, with b = 0.06 (assumed for a fine cohesive powder)
    unload_modulus=70.0,  # as for rice
)

RICE: Final = Content(
    density_kg_m3=800.0,  # milled; assumed between KIBAR's 560 to 595 of rough rice and 850 of polished long grain
    solid_share=0.58,  # KIBAR: porosity of 42 %
    lateral_ratio=0.46,  # 1 - sin(friction)
    friction_deg=32.5,  # KIBAR
    load_modulus=23.0,  # assumed: a third of the modulus on unloading
    unload_modulus=70.0,  # EN1991-4 annex C: dry agricultural grains
)

CONTENTS: Final = {"empty": EMPTY, "water": WATER, "yogurt": YOGURT, "flour": FLOUR, "rice": RICE}
"""Contents by the names that data sets use."""

BEARING_FACTOR: Final = 5.14
"""2 + pi (Prandtl 1920): pressure that a weightless medium carries, over its yield stress in shear."""

FILL: Final = 0.9
"""Thesis 5.1: "the same amount of content that is about 90 % of the container"."""
FILL_SD: Final = 0.01
"""Assumed: a centilitre for each litre."""

# Containers ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Wall:
    """An orthotropic elastic wall, 1 along the perimeter, 2 along the height.

    thickness_m; young_pa: (1, 2); poisson: strain along 2 over strain along 1 under stress along 1; shear_pa
    density_kg_m3; thickness_cv, young_cv: coefficients of variation between instances"""

    thickness_m: float
    young_pa: tuple[float, float]
    poisson: float
    shear_pa: float
    density_kg_m3: float
    thickness_cv: float
    young_cv: float


CARDBOARD: Final = Wall(
    thickness_m=0.45e-3,  # XIA: five-ply board of 0.43 mm
    young_pa=(5.5e9, 2.0e9),  # XIA: machine direction, which runs around a carton; cross direction
    poisson=0.38,  # XIA
    shear_pa=1.25e9,  # XIA
    density_kg_m3=780.0,  # XIA
    thickness_cv=0.01,  # assumed: within the +-3 % that makers of board give
    young_cv=0.03,  # assumed: moisture between sessions; PODDAR finds 7 % over a decade of strain rate
)

PLASTIC: Final = Wall(
    thickness_m=0.45e-3,  # assumed: a light blow-moulded bottle
    young_pa=(0.9e9, 0.9e9),  # CRAWFORD
    poisson=0.42,  # CRAWFORD
    shear_pa=0.9e9 / (2.0 * 1.42),  # isotropic
    density_kg_m3=955.0,  # CRAWFORD
    thickness_cv=0.02,  # assumed
    young_cv=0.03,  # assumed: 10 degC of temperature and the batch
)

BOX_M: Final = (0.060, 0.090, 0.160)
"""Outer size along the squeeze, across it and upwards; assumed: a carton of 0.86 litres that two fingers of 155 mm
reach around."""
CYLINDER_M: Final = (0.035, 0.160)
"""Radius and height; assumed: a bottle of 0.62 litres."""

TABLE_FRICTION: Final = 0.35
"""Friction of cardboard or plastic on a table; assumed within the 0.2 to 0.5 that handbooks give for both."""

# Fingertips and hand ------------------------------------------------------------------------------------------------

PAD_OFFSET_M: Final = 0.011
"""Distance from the axis of the distal link to the surface of its pad; assumed: half of a link of 22 mm."""
PAD_CURVATURE_M: Final = 0.060
"""Radius of the pad across the finger; assumed: nearly flat, with rounded edges."""
PAD_LENGTH_CURVATURE_M: Final = 0.100
"""Radius of the whole pad along the finger; Assumed: slightly convex, so that its ends do not carry the load."""
TIP_CURVATURE_M: Final = 0.030
"""Additional radius along the finger, by which the rows towards the tip are set back; assumed: a rounded tip."""
TIP_ROWS: Final = 5
"""How many rows towards the tip are curved; assumed."""
TIP_MARGIN_M: Final = 0.006
"""Distance from the end of the distal link's axis back to the middle of the first row; assumed."""
PAD_STIFFNESS_PA_M: Final = 4.0e8
"""Pressure over compression of the pad's foam cover: 1 MPa over 2.5 mm; assumed for a closed-cell rubber."""

TORQUE_NM_PER_A: Final = (0.0, 2.1, 1.4, 2.1, 1.4, 2.1, 1.4)
"""Torque of each axis at the limit of its current, by axis; ROBWORK's limits over the 1 A that Schunk's library allows.
The base axis carries no load here."""
GEAR_LOSS: Final = 0.15
"""Mean share of the torque that is lost by friction in motor and gear; assumed."""
GEAR_LOSS_SD: Final = 0.02
"""Variation from squeeze to squeeze; assumed: grease and position of the gear."""
GEAR_LOSS_PER_K: Final = -0.002
"""Per kelvin of the motor above 24 degC: warm grease is thinner; assumed."""

PA_PER_COUNT: Final = 250e3 / 3500.0
"""ROS. Schunk's preliminary value (0.8 Pa per count) would saturate at the lightest touch."""
TEXEL_GAIN_SD: Final = 0.08
"""Variation between texels, fixed for a hand; assumed for a resistive polymer without calibration of each texel."""
PAD_DRIFT_PER_K: Final = -0.01
"""Change of the gain per kelvin; assumed for carbon-filled polymer."""
NOISE_COUNTS: Final = 4.0
"""Standard deviation of a texel, as in the DSA double."""

TEMPERATURE_SD_K: Final = 2.0
"""Deviation of the room's temperature between sessions, and of a container's temperature since it was closed;
assumed."""

# Grasp --------------------------------------------------------------------------------------------------------------

GRASP_ALONG_M: Final = 0.010
"""Half the range along the longest edge, around its middle; assumed for the thesis's "around its middle region"."""
GRASP_DEEP_M: Final = 0.004
"""Half the range into the hand; assumed."""
OFF_CENTRE_M: Final = 0.002
"""Half the range along the squeeze: which finger touches first; assumed."""
YAW_DEG: Final = 1.5
"""Half the range about the vertical; assumed."""
ROLL_DEG: Final = 2.0
"""Half the range about the squeeze; assumed."""
