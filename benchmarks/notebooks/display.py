"""What a notebook's cells call to read the results and to show tables, figures and verdicts.

Which results are read is said outside of the notebook, so that it shows any store: ``BGN_RESULTS`` (a folder, by
default ``results/published``), ``BGN_PRESET`` and ``BGN_BUDGET`` (by default the registry's preset, and for each domain
the longest budget of most agents).
"""

from __future__ import annotations

import functools
import hashlib
import html
import io
import itertools
import os
import pathlib
from collections.abc import Mapping, Sequence

import pandas as pd
from IPython.display import HTML, Image, Markdown, display
from matplotlib.figure import Figure
from PIL import Image as Pillow

from benchmarks import pooled, registry
from benchmarks.evidence import StoredEvidence, load
from benchmarks.pooled import PooledEvidence, ResultsFolder
from bgn.analysis import presets
from bgn.analysis import recordings as robot_recordings
from bgn.analysis.cells import env_steps
from bgn.analysis.figures import style
from bgn.analysis.statistics import rate_interval
from bgn.analysis.text_table import TextTable

ROOT = pathlib.Path(__file__).parents[2]
STAMP = "Results read:"
"""What the line with the results' hash starts with."""
_WIDEST = 1400  # pixels of a picture


def results() -> pathlib.Path:
    """Return the folder whose results are shown."""
    return pathlib.Path(os.environ.get("BGN_RESULTS", ROOT / "results" / "published"))


@functools.cache
def _folder(path: pathlib.Path) -> ResultsFolder:
    """Return the folder of results, of which a page reads many parts."""
    return pooled.folder(path)


def read(preset: str | None = None, *, rather: str | None = None) -> PooledEvidence:
    """Read the results to show, under the preset that was asked for outside unless one is named here.

    ``rather`` is the budget to show where none was asked for and that one is stored, under its own preset.
    """
    chosen, budget = preset or os.environ.get("BGN_PRESET") or None, os.environ.get("BGN_BUDGET") or None
    if rather and not (chosen or budget) and _has(registry.load().preset_of(rather), rather):
        budget = rather
    return _folder(results()).load(preset=chosen, budget=budget)


def read_presets() -> dict[str, PooledEvidence]:
    """Read the results of every preset that has any, in the registry's order."""
    found = set(_folder(results()).overview["preset"])
    budget = os.environ.get("BGN_BUDGET") or None
    names = [preset for preset in registry.load().presets if preset in found]
    if budget is None:
        return {name: _folder(results()).load(preset=name) for name in names}
    return {name: _folder(results()).load(preset=name, budget=budget) for name in names if _has(name, budget)}


def stamp(*evidence: StoredEvidence) -> None:
    """Print the hash of the results that were read, with preset, budgets and numbers of runs."""
    for one in evidence:
        seeds = sorted({len(group) for _, group in one.runs.groupby(["domain", "agent"])})
        n = f"{seeds[0]}" if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}" if seeds else "0"
        older = int(one.runs["older"].sum())
        note = f"; {older} of other code or settings than the present ones" if older else ""
        budgets = "budget" if " and " not in one.budget else "budgets"
        print(
            f"{STAMP} {digest(one)} | preset {one.preset}, {budgets} {one.budget} | {len(one.runs)} runs, "
            f"n = {n} per cell{note}"
        )


def digest(evidence: StoredEvidence) -> str:
    """Hash what the results say: runs and reference rows by id, with every number but times."""
    parts = []
    for frame in (evidence.runs, evidence.references):
        numeric = [str(column) for column in frame.select_dtypes("number")]
        numeric = [name for name in numeric if not name.endswith(("seconds", "_per_second"))]
        columns = [c for c in ("run", "budget", "preset") if c in frame] + sorted(numeric)
        ordered = frame[columns].sort_values(["run", "budget"]) if len(frame) else frame[columns]
        parts.append(ordered.to_csv(index=False, float_format="%.6g"))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]


def answer(text: str) -> None:
    """Show a notebook's answer in one sentence."""
    display(Markdown(f"> **{text}**"))


def figure(drawn: Figure) -> None:
    """Show a figure."""
    display(Image(style.png(drawn), format="png"))


def picture(image: Pillow.Image) -> None:
    """Show a picture, with few colours: a strip of a film is small that way."""
    if image.width > _WIDEST:
        height = round(image.height * _WIDEST / image.width)
        image = image.resize((_WIDEST, height), Pillow.Resampling.LANCZOS)
    content = io.BytesIO()
    image.convert("RGB").quantize(128, dither=Pillow.Dither.NONE).save(content, format="png", optimize=True)
    display(Image(content.getvalue(), format="png"))


def table(shown: TextTable) -> None:
    """Show a printed table."""
    display(HTML(f'<div class="bgn-table">{shown.html()}</div>'))


def frame(shown: pd.DataFrame, *, index: bool = False) -> None:
    """Show a frame of texts and numbers."""
    if shown.empty:
        display(Markdown("*Nothing is stored to show here.*"))
        return
    text = shown.to_html(index=index, border=0, escape=True, na_rep="", float_format=lambda v: f"{v:.3g}")
    display(HTML(f'<div class="bgn-table">{text}</div>'))


def verdicts(evidence: StoredEvidence, notebook: str) -> None:
    """Show the claims that a notebook is about: the quotation, its verdict and what that rests on."""
    chosen = evidence.claims[evidence.claims["notebook"] == notebook]
    rows = []
    for _, claim in chosen.iterrows():
        quote, section = html.escape(claim["quote"]), html.escape(claim["section"])
        rows.append(f'<tr class="start"><td colspan="3">“{quote}” <small>(§ {section})</small></td></tr>')
        cells = (html.escape(claim["asks"]), f"<b>{claim['verdict']}</b>", html.escape(_rests_on(claim)))
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    display(HTML(f'<div class="bgn-table words"><table>{"".join(rows)}</table></div>'))


def overview() -> None:
    """Show which budgets and presets are stored, with agents, runs and steps per domain."""
    found = _folder(results()).overview
    if found.empty:
        frame(found)
        return
    steps = (found["env_steps"] / 1e6).map("{:g} M".format)
    found["what"] = (
        found["runs"].map("{} runs of ".format) + found["agents"].map("{} agents, ".format) + steps
    )
    order = list(dict.fromkeys(registry.load().domains))
    wide = found.pivot(index=["preset", "budget"], columns="domain", values="what")
    wide = wide[[domain for domain in order if domain in wide]].fillna("")
    frame(wide.reset_index(), index=False)


def film_strip(evidence: PooledEvidence, domain: str, agent: str, seed: int = 3) -> None:
    """Show an episode in physics of the first stored policy of a cell: scene, reconstructed belief, exact belief.

    Where the evidence has none, one of another budget or preset is shown, and named.
    """
    _strip(evidence, domain, agent, seed, scene=True)


def beliefs(evidence: PooledEvidence, domain: str, agent: str, seed: int = 3) -> None:
    """Show the reconstructed and the exact belief over an episode of the first stored policy of a cell."""
    _strip(evidence, domain, agent, seed, scene=False)


def _strip(evidence: PooledEvidence, domain: str, agent: str, seed: int, *, scene: bool) -> None:
    from bgn.pictures import film  # imported here because MuJoCo takes a second, and most pages do without

    found = _first_policy(evidence, f"{domain}/{agent}/")
    if found is None:
        display(
            Markdown(f"*No policy of {domain}/{agent} is stored: train with `--budget paper` to see it act.*")
        )
        return
    source, run = found
    policy = source.policy(run)
    recorded = (
        film.record_if_possible(policy.domain, policy, seed)
        if scene
        else film.record(policy.domain, policy, seed, scene=False)
    )
    picture(film.strip(recorded))
    print(f"{run} of {source.budget}/{source.preset}, greedy, episode {seed}")


def _first_policy(evidence: PooledEvidence, cell: str) -> tuple[StoredEvidence, str] | None:
    """Return where the first policy of a cell lies, and its run: in the evidence or, for want of one, elsewhere."""
    there = _folder(results()).overview
    others = there[there["domain"] == cell.partition("/")[0]][["budget", "preset"]].itertuples(index=False)
    places = (load(results(), budget=budget, preset=preset) for budget, preset in others)
    for source in itertools.chain(evidence.parts.values(), places):
        runs = [run for run in source.policies() if run.startswith(cell)]
        if runs:
            return source, runs[0]
    return None


def by_preset(domains: Sequence[str], quantity: str) -> None:
    """Show a quantity of the stored runs of some domains: a row per preset and budget, a column per agent."""
    found = _folder(results()).overview
    pairs = found[["preset", "budget"]].drop_duplicates().itertuples(index=False)
    evidences = {f"{p}, {b}": _folder(results()).load(preset=p, budget=b) for p, b in pairs}
    for domain in domains:
        shown = presets.by_preset(list(evidences.values()), list(evidences), domain, quantity)
        if shown.rows:
            table(shown)


def preset_settings(read: Mapping[str, PooledEvidence], domain: str) -> None:
    """Show the settings in which the stored presets differ on a domain."""
    known = registry.load().presets
    chosen = {name: known[name].hyperparameters(domain) for name in read if domain in read[name].budgets}
    differing = presets.differing_settings(chosen)
    if differing.empty:
        display(Markdown(f"*{domain}: the {len(chosen)} stored presets do not differ.*"))
        return
    differing.index.name = domain
    frame(differing.reset_index())


def missing_presets(read: Mapping[str, PooledEvidence]) -> None:
    """Say which presets of the registry have no stored runs, so that nothing is said of them."""
    lacking = [name for name in registry.load().presets if name not in read]
    if lacking:
        display(Markdown(f"Not run, or not stored here: {', '.join(lacking)}. Nothing is claimed of them."))


def costs() -> None:
    """Show core-hours, steps and steps per CPU second of everything stored, by budget, preset and device."""
    rows = []
    for preset, budget in (
        _folder(results()).overview[["preset", "budget"]].drop_duplicates().itertuples(index=False)
    ):
        for device, runs in _folder(results()).load(preset=preset, budget=budget).runs.groupby("device"):
            steps, seconds = sum(env_steps(runs)), runs["cpu_seconds"].sum()
            shared = device != "cpu"  # what one run of many took of a GPU is not known
            rows.append(
                {
                    "preset": preset,
                    "budget": budget,
                    "device": device,
                    "runs": len(runs),
                    "million steps": f"{steps / 1e6:,.1f}",
                    "core-hours": "–" if shared else f"{seconds / 3600:,.2f}",
                    "steps per CPU second": "–" if shared else f"{steps / seconds:,.0f}",
                    "machines": ", ".join(sorted(set(runs["machine"]))),
                }
            )
    frame(pd.DataFrame(rows))


def physics(evidence: PooledEvidence) -> None:
    """Show how often final policies succeed in MuJoCo, by robot domain and agent."""
    runs = evidence.runs
    if "physics_success" not in runs or runs["physics_success"].isna().all():
        display(Markdown("*No stored policy was run in physics.*"))
        return
    rows = []
    for (domain, agent), cell in runs[runs["physics_success"].notna()].groupby(
        ["domain", "agent"], sort=False
    ):
        counts = cell["physics_episodes"].astype(int).tolist()
        low, high = rate_interval(cell["physics_success"].tolist(), counts)
        row = {"domain": domain, "agent": evidence.agent_titles[str(agent)], "runs": len(cell)}
        row |= {"episodes": sum(counts), "success": f"{cell['physics_success'].mean():.3f}"}
        rows.append(row | {"95 % of a seed's rate": f"{low:.3f} to {high:.3f}"})
    frame(pd.DataFrame(rows))


def recordings() -> None:
    """Show the recorded episodes on the robot, or say that there are none."""
    folder = pathlib.Path(os.environ.get("BGN_RECORDINGS", results() / "robot"))
    found = robot_recordings.episodes(folder)
    if found.empty:
        answer("No recordings yet: nothing is claimed of the robot.")
        return
    shown = robot_recordings.success_table(found)
    real = int((found["evidence"] == "robot").sum())
    answer(f"{real} episodes are recorded on the robot and {len(found) - real} on its simulated twin.")
    table(shown)


def _rests_on(claim: pd.Series) -> str:
    parts = [
        claim["statistic"],
        f"n = {claim['runs']}" if claim["runs"] else "",
        f"{claim['env_steps']} steps" if claim["env_steps"] else "",
        f"by Table 6 itself: {claim['by_table_6']}" if claim["by_table_6"] else "",
    ]
    return "; ".join(part for part in parts if part)


def _has(preset: str, budget: str) -> bool:
    return (results() / budget / preset / "runs").is_dir()
