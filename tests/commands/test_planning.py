import json
import stat

import numpy as np
import pytest

from bgn import __main__ as command_line
from bgn.commands import solve
from bgn.planning.appl import solve_with_appl
from bgn.planning.sarsop import PlanningError
from bgn.policies import alpha_file
from bgn.pomdp import reader, writer
from tests.planning.models import guess, tiger

TIGER = """# Kaelbling's tiger, by hand
discount: 0.95
values: reward
states: tiger-left tiger-right
actions: listen open-left open-right
observations: hear-left hear-right
start: uniform
T: listen identity
T: open-left uniform
T: open-right uniform
O: listen
0.85 0.15
0.15 0.85
O: open-left uniform
O: open-right uniform
R: listen : * : * : * -1
R: open-left : tiger-left : * : * -100
R: open-left : tiger-right : * : * 10
R: open-right : tiger-left : * : * 10
R: open-right : tiger-right : * : * -100
"""

# Answers as APPL's program does, with a policy that only listens; keeps what it was given.
POMDPSOL = """#!/bin/sh
cp "$1" "{kept}"
echo "$@" > "{kept}.arguments"
cat > "$7" <<'XML'
<Policy version="0.1" type="value" model="m"><AlphaVector vectorLength="3" numObsValue="1" numVectors="1">
<Vector action="0" obsValue="0">-1 -1 0 </Vector></AlphaVector></Policy>
XML
echo " Time   |#Trial |#Backup |LBound    |UBound    |Precision  |#Alphas |#Beliefs"
echo " 0.01    0       0        -1         1          2           3        1"
echo " 0.25    4       50       0.6195     0.62       0.001       7        12"
"""


@pytest.fixture
def tiger_file(tmp_path):
    path = tmp_path / "tiger.pomdp"
    path.write_text(TIGER)
    return path


def run(capsys, *arguments):
    code = command_line.main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_solve_then_evaluate_a_file(capsys, tiger_file):
    out = tiger_file.with_suffix(".policy")
    code, text, _ = run(capsys, "solve", tiger_file, "--precision", "1e-3", "--policy", out, "--json")
    result = json.loads(text)
    assert code == 0
    assert result["stopped"] == "precision"
    assert result["lower"] == pytest.approx(19.371, abs=2e-3)
    assert result["gap"] == pytest.approx(result["upper"] - result["lower"])
    assert result["gap"] <= 1e-3
    assert len(alpha_file.load(out)) == result["vectors"]
    code, text, _ = run(capsys, "evaluate", tiger_file, out, "--episodes", 4000, "--limit", 150, "--json")
    outcome = json.loads(text)
    assert code == 0
    assert outcome["mean_return"] == pytest.approx(result["lower"], abs=4 * outcome["standard_error"])
    assert outcome["interval_95_low"] < outcome["mean_return"] < outcome["interval_95_high"]


def test_plain_output_names_the_numbers(capsys, tiger_file):
    code, text, _ = run(capsys, "solve", tiger_file, "--precision", "0.1")
    assert code == 0
    assert "lower  19.3" in text
    assert "stopped  precision" in text


@pytest.mark.parametrize("policy", ["random", "qmdp", "fib", "always:east"])
def test_a_domain_and_a_named_policy(capsys, policy):
    arguments = (
        "evaluate",
        "rocksample-4-4",
        policy,
        "--episodes",
        50,
        "--convention",
        "hidden-first-action",
    )
    code, text, _ = run(capsys, *arguments)
    assert code == 0
    assert "mean return" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("solve", "nowhere.pomdp"), "nowhere.pomdp: no such file, nor a domain; domains: hallway"),
        (("solve", "{bad}"), "bad.pomdp"),
        (("solve", "{tiger}", "--precision", "0"), "precision 0 is impossible"),
        (("solve", "{tiger}", "--timeout", "0"), "timeout 0 is not positive"),
        (("solve", "{tiger}", "--policy", "no/such/out.policy"), "there is no folder"),
        (("evaluate", "{tiger}", "always:sing"), "no action 'sing'; known: listen"),
        (("evaluate", "{tiger}", "missing.policy"), "missing.policy"),
        (("solve", "top-plate", "--convention", "hidden-first-action"), "no hidden first action"),
    ],
)
def test_errors_are_one_clear_line(capsys, tmp_path, tiger_file, arguments, message):
    bad = tmp_path / "bad.pomdp"
    bad.write_text(TIGER.replace("0.85 0.15\n", "0.85 0.25\n", 1))
    places = {"{tiger}": tiger_file, "{bad}": bad}
    code, out, err = run(capsys, *(places.get(a, a) for a in arguments))
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert message in err
    assert len(err.splitlines()) <= 3


def test_ctrl_c_saves_the_policy(capsys, monkeypatch, tmp_path):
    def interrupt(self, progress):
        raise KeyboardInterrupt

    monkeypatch.setattr(solve._Reporter, "__call__", interrupt)
    out = tmp_path / "so-far.policy"
    code, text, _ = run(capsys, "solve", "hallway", "--policy", out, "--json")
    assert code == 130
    assert json.loads(text)["stopped"] == "interrupted"
    assert alpha_file.load(out).vectors.shape[1] == 60


def test_pomdpsol_is_run_on_an_absorbing_file(monkeypatch, tmp_path):
    program, kept = tmp_path / "pomdpsol", tmp_path / "given.pomdp"
    program.write_text(POMDPSOL.format(kept=kept))
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    solution = solve_with_appl(guess(), precision=1e-3, timeout=9)
    given = reader.load(kept)
    assert not given.reset.any()
    assert given.transitions[1].toarray()[:, 2].tolist() == [1, 1, 1]
    assert "--precision 0.001 --timeout 9 --output" in (tmp_path / "given.pomdp.arguments").read_text()
    assert (solution.progress.lower, solution.progress.upper) == (0.6195, 0.62)
    assert (solution.progress.vectors, solution.progress.beliefs) == (7, 12)
    assert solution.policy.vectors.tolist() == [[-1, -1]]
    assert solution.reason == "precision"


def test_pomdpsol_missing_or_failing_is_said(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(PlanningError, match="pomdpsol is not on the PATH"):
        solve_with_appl(tiger(), precision=1e-3, timeout=9)
    program = tmp_path / "pomdpsol"
    program.write_text("#!/bin/sh\necho no memory >&2\nexit 3\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    with pytest.raises(PlanningError, match="exit code 3: no memory"):
        solve_with_appl(tiger(), precision=1e-3, timeout=9)


def test_the_converted_file_keeps_the_optimum(capsys, tmp_path):
    from bgn.planning.episodic import without_resets

    path = tmp_path / "guess.pomdp"
    writer.save(without_resets(guess()), path)
    code, text, _ = run(capsys, "solve", path, "--precision", "1e-6", "--json")
    assert code == 0
    assert json.loads(text)["lower"] == pytest.approx(0.62, abs=2e-6)
    assert np.isfinite(json.loads(text)["seconds"])
