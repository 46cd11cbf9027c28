"""Hidden effects from images on: rendered, correlated, recorded in a log, and named by `semlive diagnose LOG`.

    python tests/benchmarks/bench_diagnose_rendered.py --seeds 1 --sizes 8 --nulls 6 --folder rendered [--shard 1/2]
    python tests/benchmarks/bench_diagnose_rendered.py --set final --seeds 6 --sizes 4 --nulls 150 --doubles 36 --varied --folder varied
    python tests/benchmarks/bench_diagnose_rendered.py ... --folder rendered --score [--write]

Cases are those of `bench_diagnose.py`, 15 pairs of 1024 x 884 px with the paper's dots and 0.025 px of noise. The program is started on
each log as a user would; the hidden effect is not in the log. `--varied` draws the texture (dots or a gold film) and the noise of each
case; sizes are then multiples of the detection limit at that noise. It continues after a stop like the other campaign. The own bias of the
correlation (`dic_subpixel_bias`), which is in all of these images, is correct next to any hidden effect, and alone where nothing was.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bench_diagnose import PAGE, verdicts
from blind.cases import Case, Counts, cases
from blind.hiding import DETECTABLE_PX
from blind.rendering import PAPER_NOISE_PX, noise_px, paper_images, rendered_log, varied_images
from blind.scoring import Verdict, table, without_correlation_bias

from semlive_simulators.scenario import Scenario

BEGIN, END = "<!-- rendered: begin -->\n", "<!-- rendered: end -->\n"


def main() -> None:
    """Run what is missing, or score what is there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", choices=("development", "final"), default="development")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--sizes", type=float, nargs="*", default=[8.0], help="times what can be detected")
    parser.add_argument("--effects", nargs="*", default=list(DETECTABLE_PX))
    parser.add_argument("--nulls", type=int, default=6)
    parser.add_argument("--doubles", type=int, default=0)
    parser.add_argument("--varied", action="store_true", help="another texture and noise in each case")
    parser.add_argument("--shard", default="1/1", help="k/n: every n-th case from the k-th on")
    parser.add_argument("--folder", type=Path, default=Path("rendered"))
    parser.add_argument("--logs", type=Path, help="keep the logs (57 MB each), and use those that are there")
    parser.add_argument("--render", action="store_true", help="make the logs only")
    parser.add_argument("--score", action="store_true", help="run nothing")
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/diagnosis.md")
    requests = parser.parse_args()
    chosen = list(cases(requests.set, Counts(requests.seeds, requests.nulls, requests.doubles), requests.sizes, requests.effects))
    for folder in (requests.folder, requests.logs):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    if not requests.score:
        own, shards = (int(entry) for entry in requests.shard.split("/"))
        _run(chosen[own - 1 :: shards], requests.folder / f"verdicts-{own}-of-{shards}.jsonl", requests)
    stored = verdicts(requests.folder)
    scored = [(_at_noise_of(case, stored[case.key]), without_correlation_bias(stored[case.key])) for case in chosen if case.key in stored]
    lines = [entry for entry in table(scored).splitlines() if "| 0 of 0 |" not in entry]
    found = "\n".join([*lines, *_costs([entry for _, entry in scored])]) + "\n"
    sys.stdout.write(found)
    if requests.write:
        page = PAGE.read_text(encoding="utf-8")
        before, rest = page.split(BEGIN)
        about = f"{len(scored)} cases of the {requests.set} set."
        PAGE.write_text(f"{before}{BEGIN}\n{about}\n\n{found}\n{END}{rest.split(END)[1]}", encoding="utf-8")


def _run(chosen: list[Case], folder: Path, requests: argparse.Namespace) -> None:
    done = verdicts(folder.parent)
    for case in (case for case in chosen if case.key not in done):
        images = varied_images(case.seed) if requests.varied else paper_images(case.seed)
        ratio = noise_px(images) / PAPER_NOISE_PX if requests.varied else 1.0
        with tempfile.TemporaryDirectory(dir=requests.logs) as name:
            log = _log_of(replace(case, noise_ratio=ratio), images, Path(name), requests)
            if not requests.render:
                with folder.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps({"key": case.key, "noise_ratio": ratio, **judge(log)}) + "\n")


def _at_noise_of(case: Case, verdict: Verdict) -> Case:
    """The case with the effects that were rendered: the sizes are proportional to the noise of the images."""
    return replace(case, noise_ratio=float(str(verdict["noise_ratio"])))


def _log_of(case: Case, images: Scenario, work: Path, requests: argparse.Namespace) -> Path:
    """The log of a case: rendered, or the stored one."""
    stored = None if requests.logs is None else requests.logs / f"{'varied-' if requests.varied else ''}{case.key}"
    if stored is not None and stored.exists():
        return stored
    log = rendered_log(work / "run", images, replace(case.conditions(), noise_px=0.0), case.effects())
    return log if stored is None else log.rename(stored)


def judge(log: Path) -> Verdict:
    """Verdict of the program on a log, without further information."""
    begin, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run([sys.executable, "-m", "semlive", "diagnose", str(log), "--json"], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "outcome": found["outcome"],
        "names": [entry["name"] for entry in found["effects"]],
        "ambiguous": found["ambiguous"],
        "parameters": {
            entry["name"]: {name: [item["value"], item["sigma"]] for name, item in entry["parameters"].items()}
            for entry in found["effects"]
        },
        "closure": None,
        "cpu_s": used.ru_utime - before,
        "wall_s": time.monotonic() - begin,
        "most_mb": used.ru_maxrss / 1024,
    }


def _costs(found: list[Verdict]) -> Iterator[str]:
    if found:
        wall_s, most_mb = (max(float(str(entry[what])) for entry in found) for what in ("wall_s", "most_mb"))
        yield f"The longest verdict took {wall_s:.0f} s, the largest {most_mb:.0f} MB."


if __name__ == "__main__":
    main()
