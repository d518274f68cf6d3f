"""`python -m deformscope.bench`: the rows as JSON, on a machine with only numpy, scipy and warp.

python -m deformscope.bench --device cuda --json -
python -m deformscope.bench --quick --only step,relax --json bench.json
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from deformscope.bench_cases import CASES
from deformscope.plain import plain


def main() -> int:
    """Measure, with progress on stderr; finished measurements are written, also after an interruption."""
    parser = argparse.ArgumentParser(prog="python -m deformscope.bench", description=__doc__)
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    parser.add_argument("--sizes", type=lambda text: tuple(int(part) for part in text.split(",")))
    parser.add_argument("--repeats", type=int)
    parser.add_argument("--only", type=lambda text: tuple(text.split(",")), default=CASES, help=",".join(CASES))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--against", type=Path)
    parser.add_argument("--json", default="-")
    asked = parser.parse_args()
    if unknown := set(asked.only) - set(CASES):
        parser.error(f"expected --only out of {','.join(CASES)}; got {', '.join(sorted(unknown))}")

    import warp as wp

    from deformscope.bench.plan import BenchPlan, default_sizes
    from deformscope.bench.report import Report, run_bench
    from deformscope.bench.timing import TimingRow
    from deformscope.errors import InputError
    from deformscope.stages.msm.solver import pick_device

    def write(found: Report, rows: Sequence[TimingRow]) -> None:
        for row in rows:
            print(row.case, row.what, row.who, row.median, row.unit, row.doubt, sep="\t", file=sys.stderr)
        text = json.dumps(plain(found), indent=2, allow_nan=False) + "\n"
        if asked.json == "-":
            sys.stdout.write(text)
        else:
            Path(asked.json).write_text(text, encoding="utf-8")

    wp.config.log_level = wp.LOG_WARNING
    try:
        device = pick_device(asked.device)
        sizes = asked.sizes or default_sizes(device, asked.quick)
        plan = BenchPlan(device, sizes, asked.repeats, asked.quick, asked.only)
        run_bench(plan, asked.against, lambda text: print(text, file=sys.stderr, flush=True), write)
    except InputError as error:
        print(f"deformscope: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
