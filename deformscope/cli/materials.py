"""`deformscope calibrate axes|field|yield|viscous`: a beta along each axis, relative stiffness of each place, yield
strain, and relaxing share of the modulus."""

from deformscope.cli.common import EXIT_LOSSES, fit_progress, say, show, write_file, write_json
from deformscope.config import MaterialOptions
from deformscope.runs.materials import calibrate_material, material_page


def run(config: MaterialOptions) -> int:
    """`calibrate axes|field|yield|viscous`: images, a recording, or files. Returns the command's exit status."""
    with fit_progress() as progress:
        found = calibrate_material(config, note=say, progress=progress)
    show(found)
    files = config.summary
    if files.picture is not None:
        write_file(files.picture, found.figures()[0].png)
    if files.report is not None:
        write_file(files.report, material_page(found).encode())
    write_json(found.to_dict(), config.output.json)
    if found.problems:
        say(f"deformscope: {config.sources[0]} is damaged: {'; '.join(found.problems)}")
        return EXIT_LOSSES
    return 0
