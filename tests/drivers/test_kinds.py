"""What every driver of this project owes its users by its kind, as a stranger's does."""

from deformscope_drivers.contract.test_installed import TestArms as TestArms
from deformscope_drivers.contract.test_installed import TestColorCameras as TestColorCameras
from deformscope_drivers.contract.test_installed import TestDepthCameras as TestDepthCameras
from deformscope_drivers.contract.test_installed import TestForceSensors as TestForceSensors
from deformscope_drivers.contract.test_installed import TestHands as TestHands
from deformscope_drivers.contract.test_installed import TestTactileArrays as TestTactileArrays
