"""`deformscope new-device`: a package for a device of one's own."""

from deformscope.cli.common import say
from deformscope.config import NewDeviceConfig
from deformscope.errors import InputError
from deformscope_drivers.errors import DeviceError
from deformscope_drivers.new_package import write_package


def run(config: NewDeviceConfig) -> None:
    """Write the package, and say how it is installed and tried."""
    try:
        folder = write_package(config.out, config.name, config.kind).absolute()  # pip asks a registry for a bare name
    except (DeviceError, OSError) as error:
        raise InputError.about(error, "new-device") from error
    say(f'{folder} is written. Next: pip install -e {folder}; then driver = "{config.name}", double = true in a rig')
    say(f"its tests: pytest {folder / 'tests'}")
