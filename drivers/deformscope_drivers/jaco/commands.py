"""The trajectory point of a velocity."""

from deformscope_drivers.arm.device import JointVelocity, Velocity
from deformscope_drivers.jaco import structures


def velocity_point(velocity: Velocity) -> structures.TrajectoryPoint:
    """The point that asks for a velocity during one cycle of the arm (the device sends those of joints alone)."""
    point = structures.TrajectoryPoint()
    if isinstance(velocity, JointVelocity):
        point.Position.Type = structures.PositionType.ANGULAR_VELOCITY
        point.Position.Actuators = structures.AngularInfo(*velocity.rates_deg_s)
    else:
        point.Position.Type = structures.PositionType.CARTESIAN_VELOCITY
        point.Position.CartesianPosition = structures.CartesianInfo(*velocity.linear_m_s, *velocity.angular_rad_s)
    return point
