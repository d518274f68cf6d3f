"""What a touch measured, on its way to the process that computes."""

import pickle

import numpy as np

from deformscope.experiments.measured import FrameData
from deformscope.robot.readings import ArmSample


def frame_data(readings: int) -> FrameData:
    rng = np.random.default_rng(3)
    poses = [ArmSample(10**18 + n, rng.normal(size=(4, 4)), (1.5 * n, -0.1, 3.0), n % 3) for n in range(5)]
    return FrameData(
        {7: rng.normal(size=(4, 6)).astype(np.float32)},
        {pose.time_ns: pose for pose in poses},
        {(10**18 + n, n % 4096): rng.normal(size=3) for n in range(readings)},
    )


def test_it_arrives_as_it_was_sent() -> None:
    sent = frame_data(100)
    came = pickle.loads(pickle.dumps(sent))
    assert list(came.depth_m) == [7]
    assert came.depth_m[7].dtype == np.float32
    np.testing.assert_array_equal(came.depth_m[7], sent.depth_m[7])
    assert list(came.arm) == list(sent.arm)
    for when, pose in sent.arm.items():
        assert (came.arm[when].time_ns, came.arm[when].fifo_count) == (when, pose.fifo_count)
        assert came.arm[when].joints_deg == pose.joints_deg
        np.testing.assert_array_equal(came.arm[when].T_base_ee, pose.T_base_ee)
    assert list(came.wrench_n) == list(sent.wrench_n)
    for key, force_n in sent.wrench_n.items():
        np.testing.assert_array_equal(came.wrench_n[key], force_n)


def test_nothing_arrives_as_nothing() -> None:
    came = pickle.loads(pickle.dumps(FrameData({}, {}, {})))
    assert (came.depth_m, came.arm, came.wrench_n) == ({}, {}, {})


def test_readings_travel_as_few_arrays() -> None:
    """Each array of its own would keep Python's lock, and with it the robot's control period, for 10 us and more."""
    more = len(pickle.dumps(frame_data(1100))) - len(pickle.dumps(frame_data(100)))
    assert more <= 1000 * (3 + 2) * 8 + 100
