"""APPL's ``pomdpsol``, the C++ SARSOP, where the user has it: on a converted file, read back in our terms."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from bgn.planning.episodic import without_resets
from bgn.planning.sarsop import PlanningError, Progress, Solution
from bgn.policies import alpha_file
from bgn.pomdp import writer
from bgn.pomdp.model import POMDP

#: A row of pomdpsol's log: time, trials, backups, lower bound, upper bound, precision, alpha vectors,
#: beliefs.
_ROW = re.compile(r"^\s*((?:[-+.\deE]+\s+){7}[-+.\deE]+)\s*$", re.MULTILINE)


def solve_with_appl(model: POMDP, *, precision: float, timeout: float) -> Solution:
    """Run ``pomdpsol`` on the model with its resets made absorbing (it would read them as a continuing task).

    Raises
    ------
    PlanningError
        ``pomdpsol`` is not on the PATH, fails, or says something this cannot read.
    """
    program = shutil.which("pomdpsol")
    if program is None:
        raise PlanningError(
            "pomdpsol is not on the PATH: install APPL (github.com/AdaCompNUS/sarsop) or drop --solver appl"
        )
    episodic = without_resets(model)
    with tempfile.TemporaryDirectory() as folder:
        source, result = Path(folder, "model.pomdp"), Path(folder, "out.policy")
        writer.save(episodic, source)
        command = [program, str(source), "--precision", f"{precision:g}", "--timeout", f"{timeout:g}"]
        began = time.perf_counter()
        run = subprocess.run([*command, "--output", str(result)], capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - began
        if run.returncode != 0 or not result.exists():
            said = (run.stderr or run.stdout).strip().splitlines()[-3:]
            raise PlanningError(f"pomdpsol failed with exit code {run.returncode}: {' / '.join(said)}")
        policy = alpha_file.load(result)
    rows = _ROW.findall(run.stdout)
    if not rows:
        raise PlanningError(
            "pomdpsol's output has no row of bounds (time, trials, backups, lower, upper, ...)"
        )
    _, trials, backups, lower, upper, _, vectors, beliefs = map(float, rows[-1].split())
    # An added absorbing end is none of the model's states.
    policy = type(policy)(vectors=policy.vectors[:, : model.n_states].copy(), actions=policy.actions)
    progress = Progress(
        lower=lower,
        upper=upper,
        seconds=seconds,
        vectors=int(vectors),
        beliefs=int(beliefs),
        trials=int(trials),
        backups=int(backups),
    )
    return Solution(
        policy=policy, progress=progress, reason="precision" if progress.gap <= precision else "timeout"
    )
