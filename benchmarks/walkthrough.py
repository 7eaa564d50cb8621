"""Write the page on the concealed moorings from the results of the demonstration cruise.

    python benchmarks/pictures.py --from CRUISE concealed    figures of C1, docs/background/concealed.json and the page
    python benchmarks/walkthrough.py                          the page alone, from the committed JSON

All numbers of the page, and sentences about what was missed, are derived from that file.
"""

# ruff: noqa: E501, RUF100 - lines of the page are not wrapped

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive.files import read_attribute, read_json
from compasslib.effects import CATALOGUE, meanings
from compasslib.plots.timeseries import draw_errors, error_reach
from compasslib.report import words
from compasslib.report.concealed import HeadingErrors, heading_errors
from compasslib.stages.concealed import read_headings

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, FIGURES = DOCS / "background/concealed.md", DOCS / "background/concealed.json"
SIDES = ("recorded", "fit", "corrected")


def collect(cruise: Path, picture: Path) -> None:
    """Write the numbers of the page and the page from a cruise that was run, and draw C1's heading errors."""
    truths = [read_json(path) for path in sorted((cruise / "concealed").glob("*.json"))]
    folders = {truth["mooring"]: cruise / "results" / truth["mooring"] for truth in truths}
    errors = {truth["mooring"]: heading_errors(truth, read_headings(folders[truth["mooring"]])) for truth in truths}
    shown = errors["C1"]
    dates = [cause["date"] for cause in truths[0]["planted"]]
    reach = error_reach([error for each in errors.values() for error in (each.fit_deg, each.corrected_deg)])
    draw_errors(picture, shown.time_s, shown.fit_deg, shown.corrected_deg, shown.sigma_deg, dates, reach)
    history = read_attribute(cruise / "results/C1/corrected.nc", "history")
    figures = {
        "date": history[:10],
        "version": read_attribute(cruise / "results/C1/corrected.nc", "software_version"),
        "seed": truths[0]["seed"],
        "moorings": {truth["mooring"]: _mooring(cruise, truth, errors[truth["mooring"]]) for truth in truths},
    }
    FIGURES.write_text(json.dumps(figures, indent=1) + "\n")
    PAGE.write_text(page(figures))


def _mooring(cruise: Path, truth: dict[str, Any], errors: HeadingErrors) -> dict[str, Any]:
    folder = cruise / "results" / truth["mooring"]
    diagnosis, assessment = read_json(folder / "diagnosis.json"), read_json(folder / "assessment.json")
    each = {name: getattr(errors, f"{name}_deg") for name in SIDES}
    return {
        "planted": truth["planted"], "verdict": diagnosis["verdict"],
        "bayes_factor": diagnosis["bayes_factor"],
        "findings": [{k: x for k, x in entry.items() if k != "text"} for entry in diagnosis["findings"]],
        "turn": [curve for curve in diagnosis["curves"] if curve["covariate"].startswith("turn_by_")],
        "along": [curve["covariate"] for curve in diagnosis["curves"]],
        "detectable_deg": diagnosis["detectable_deg"],
        "error": {name: errors.rms(error) for name, error in each.items()},
        "error_rms_deg": {name: round(angles.rms(error[np.isfinite(error)]), 3) for name, error in each.items()},
        "sigma_rms_deg": round(errors.sigma_rms_deg, 3), "coverage": [round(share, 4) for share in errors.coverage or ()],
        "understated": errors.understated,
        "pairs": assessment["after"]["n"], "difference_deg": [assessment[key]["rms_deg"] for key in ("before", "after")],
        "files": {path.name: path.stat().st_size for path in sorted((cruise / "raw" / truth["mooring"]).iterdir())},
        "samples": len(errors.time_s),
    }  # fmt: skip


def page(figures: dict[str, Any]) -> str:
    """Compose the page."""
    moorings = figures["moorings"]
    mooring = moorings["C1"]
    (found,) = mooring["findings"]
    proof, without = found["heldout"], found["heading_error_without_deg"]
    amplitude, gain, placebo = proof["amplitude_deg"], proof["gain"], proof["placebo"]
    (turn,) = mooring["turn"]
    bins = max(np.abs(turn["before_deg"])), max(np.abs(turn["after_deg"]))
    off = mooring["error_rms_deg"]
    removed = np.sqrt(off["fit"] ** 2 - off["corrected"] ** 2)
    (field,) = (cause["field"] for cause in mooring["planted"] if cause["driver"] == found["driver"])
    values = "\n".join(
        f"| {meaning} | {words.with_sigma(value['value'], value['sigma'], value['unit'])} | {words.number(field[meaning.split()[-1]], 0)} {field['unit']} |"
        for name, value in found["parameters"].items()
        if (meaning := meanings(found["effect"])[name])
    )
    return f"""# A concealed error, step by step

Where a simulation and a recording differ, the search locates the mismatch, names the physics that was left out, models it
and shows that the fit improves; where the record does not allow this, it says so. Four demonstration moorings test it: `make run`
simulates them with faults drawn at random by a seed, which only the page that compares results with the truth reads. This page follows
C1 from the raw file to the truth, and lists what was missed.

*Written by `benchmarks/walkthrough.py` from the results of {figures["version"]}, {figures["date"]}, seed {figures["seed"]}.
`results/concealed.html` has the same comparison for your own run, and `make concealed SEED=n` draws other causes.*

## Concealed

`raw/C1/top.000` ({mooring["files"]["top.000"] / 1000:.0f} kB, RDI PD0) is the affected profiler, `raw/C1/deep.000` the reference below it. The
{mooring["samples"]} recorded headings are wrong by {mooring["error"]["recorded"]} rms (95 % interval). One cause is constant iron, which the five
coefficients of a compass near iron describe. Two more were planted; their sizes are the rms that remains after fitting these coefficients:

{_planted(mooring)}

## Located

The pipeline compares the directions of both instruments on {mooring["pairs"]} pairs and fits the five coefficients. The true error of the
headings is then still {mooring["error"]["fit"]}: one set of coefficients cannot describe the compass before and after the change, nor its
heeling. The search tests how the record differs from that fit along time, temperature, tilt, speed and the other covariates. The Bayes
factor for a fault of compass or clock is {_factor(mooring["bayes_factor"])}, and the most probable date is **{_minute(found["when"]["from"])}**
(panel c, dotted).

## Named

**{words.plain(found["effect"]).capitalize()}**, probability {words.chance(found["probability"])}; alternatives in
the catalogue: {", ".join(map(words.plain, found["alternatives"])) or "none"}. The verdict is `{mooring["verdict"]}`,
which does not exclude further errors.

![The diagnosis of C1](../diagnosis.png)

*The diagnosis of C1. (a) Held-out days, binned by the turn that a fit to the other days predicts for them: their residual before
(orange) and after (blue) subtracting the prediction. If prediction and residual were equal, the orange points would lie on the black line;
the blue line has the fitted slope. (b) The residual of all days by recorded heading. (c) The share of the step in the residual of each
week: it jumps at the date without the correction, not with it. (d) The residual along {words.plain(mooring["along"][-1])}, of the other
logged quantities the one where it is largest. (e) The size of the step on held-out days. Grey: 95 % range of noise.*

## Modelled

The step enters the equations of the compass as a field in the instrument's frame, fitted together with the coefficients:

| | value ± 1σ | truth |
|---|---|---|
{values}

Its visible size is {found["rms_effect_deg"]:.1f}° rms. On held-out days the largest residual of a point in panel (a) falls from
{bins[0]:.1f}° to {bins[1]:.1f}° with the prediction of the other days.

## Shown

* **On held-out days**, with effect, driver, date and size selected again without them, the step is
  {amplitude["held_out"]:.1f}° ({amplitude["low"]:.1f} to {amplitude["high"]:.1f}°) where the other days predict {amplitude["fitted_elsewhere"]:.1f}°. The log score of these days
  improves by {gain["value"]:.0f} ({gain["low"]:.0f} to {gain["high"]:.0f}); it improves as much in
  {round(placebo["rank_p"] * (placebo["n"] + 1)) - 1} of {placebo["n"]} records simulated without the effect. {_slope(proof["slope"])}
* **In degrees of heading**: the error without the step is stated as {without:.1f}° rms. True errors are
  {off["fit"]:.1f}° with the coefficients alone and {off["corrected"]:.1f}° as corrected, and √({off["fit"]:.1f}² − {off["corrected"]:.1f}²) = {removed:.1f}°.
* **Stated uncertainty**: {mooring["sigma_rms_deg"]:.1f}° (1σ, rms); {_share(mooring)} of the headings lie within their 95 % range.

![Heading errors of C1](../concealed_errors.png)

*The error of each heading, corrected minus true; the truth was not available to the pipeline. (a) With the coefficients alone, (b) as corrected, with the
95 % range that `corrected.nc` states for single headings. Dotted: when the iron changed.*

The raw difference of directions ({mooring["difference_deg"][0]:.1f}° rms before, {mooring["difference_deg"][1]:.1f}° after all corrections) says
little about the headings: most of it is the difference of the currents between the two depths, and noise.

## What it missed

| mooring | true cause | verdict | recorded | coefficients | corrected | within 95 % |
|---|---|---|---|---|---|---|
{_rows(moorings)}

Rms heading error, with its 95 % interval.

{_missed(moorings)}

{_judgement(moorings)} Four moorings are
no statistics. The [sealed proof](proof.md) has 450, and the [known misses](../proof/known-misses.md) say what is missed and why.
"""


def _slope(slope: dict[str, float] | None) -> str:
    """State whether the held-out days agree with the prediction in size and form."""
    if slope is None:
        return "The step is too small for a slope."
    agrees = "agree to within chance" if slope["low"] <= 1.0 <= slope["high"] else "differ by more than chance"
    return f"The slope in panel (a) is {slope['value']:.2f} ({slope['low']:.2f} to {slope['high']:.2f}): the parts of the record {agrees}."


def _share(mooring: dict[str, Any]) -> str:
    return "{:.0f} % ({:.0f}–{:.0f})".format(*(100.0 * share for share in mooring["coverage"]))


def _minute(utc: str) -> str:
    return f"{utc[:10]} {utc[11:16]}"


def _planted(mooring: dict[str, Any]) -> str:
    lines = []
    for cause in mooring["planted"]:
        date = f", on {_minute(cause['date'])}" if cause["date"] else ""
        lines.append(f"* {cause['what']}{date}: {cause['size_deg']:.1f}° rms")
    return "\n".join(lines)


def _rows(moorings: dict[str, Any]) -> str:
    return "\n".join(
        f"| {name} | {'; '.join(cause['what'] for cause in m['planted']) or 'nothing'} | `{m['verdict']}` | "
        f"{' | '.join(m['error'][key] for key in SIDES)} | {_share(m)} |"
        for name, m in moorings.items()
    )


def _factor(x: float) -> str:
    power = int(np.floor(np.log10(x)))
    return f"{x / 10.0**power:.0f} × 10{str(power).translate(str.maketrans('0123456789', '⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


def _judgement(moorings: dict[str, Any]) -> str:
    """State where the uncertainty is right, and how many missed causes exceed a stated detection limit."""
    held = [name for name, m in moorings.items() if not m["understated"]]
    off = [name for name in moorings if name not in held]
    missed = [
        cause["size_deg"] > min(limits.values())
        for m in moorings.values()
        for cause in m["planted"]
        if cause["driver"] not in {finding["driver"] for finding in m["findings"]} and (limits := _limits(cause, m))
    ]
    wrong = f"; in {' and '.join(off)} they do not, which the diagnosis did not detect" if off else ""
    return f"The stated uncertainties hold in {', '.join(held)}{wrong}. Of the causes not detected, {sum(missed)} of {len(missed)} are larger than the smallest limit stated for their driver: `consistent` is no proof."


def _missed(moorings: dict[str, Any]) -> str:
    """List for each mooring planted causes whose driver no finding has, date errors, false findings and doubts."""
    lines = []
    for name, m in moorings.items():
        found = {finding["driver"]: finding for finding in m["findings"]}
        for cause in m["planted"]:
            if not (finding := found.get(cause["driver"])):
                limits = ", ".join(f"{words.plain(effect)} {limit:.1f}°" for effect, limit in _limits(cause, m).items())
                lines.append(
                    f"* **{name}: not detected**, {cause['what']}, {cause['size_deg']:.1f}° rms. Detection limits by "
                    f"{cause['driver']} (90 % power): {limits or 'none'}."
                )
            elif cause["date"]:
                hours = (np.datetime64(finding["when"]["from"][:-1]) - np.datetime64(cause["date"])) / np.timedelta64(
                    1, "h"
                )
                lines.append(f"* **{name}: dated** {abs(hours):.0f} hours too {'late' if hours > 0 else 'early'}.")
        if m["verdict"] == "ambiguous":
            lines += [f"* **{name}: {_doubt(finding)}" for finding in m["findings"]]
        wrong = [
            finding for driver, finding in found.items() if driver not in {cause["driver"] for cause in m["planted"]}
        ]
        lines += [f"* **{name}: false finding**, {words.plain(finding['effect'])}." for finding in wrong]
        if m["understated"]:
            lines.append(
                f"* **{name}: uncertainty too small.** Of the headings {_share(m)} lie within their 95 % range. The stated 1σ is {m['sigma_rms_deg']:.1f}° rms, the true error "
                f"{m['error_rms_deg']['corrected']:.1f}°."
            )
    return "\n".join(lines)


def _limits(cause: dict[str, Any], mooring: dict[str, Any]) -> dict[str, float]:
    """Select the detection limits of effects in the catalogue with the same driver, degrees."""
    same = {term.name for term in CATALOGUE if term.driver == cause["driver"]}
    return {name: limit for name, limit in mooring["detectable_deg"].items() if name in same and limit}


def _doubt(finding: dict[str, Any]) -> str:
    size, placebo = finding["heldout"]["amplitude_deg"], finding["heldout"]["placebo"]
    if finding["level"] == "driver" and finding["alternatives"]:
        own = finding.get("composition")
        first = f"composed:{'/'.join(own.values())}" if own else finding["effect"]
        names = " or ".join(words.plain(effect) for effect in (first, *finding["alternatives"]))
        return (
            f"driver only.** That the compass follows {words.plain(finding['driver'])} has probability "
            f"{words.chance(finding['level_probability'])}; whether in the form of {names}, this record cannot tell. On held-out days "
            f"the size is {size['held_out']:.1f}° ({words.number(size['low'])} to {size['high']:.1f}°) where the others predict "
            f"{size['fitted_elsewhere']:.1f}°."
        )
    return (
        f"not proven.** {words.plain(finding['effect']).capitalize()} has probability {words.chance(finding['probability'])}, but on held-out days its size is "
        f"{size['held_out']:.1f}° ({words.number(size['low'])} to {size['high']:.1f}°) where the others predict {size['fitted_elsewhere']:.1f}°, and "
        f"{round(placebo['rank_p'] * (placebo['n'] + 1)) - 1} of {placebo['n']} records simulated without it improve as much."
    )


if __name__ == "__main__":
    PAGE.write_text(page(json.loads(FIGURES.read_text())))
