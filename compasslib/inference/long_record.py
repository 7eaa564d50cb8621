"""Diagnose a long record: infer effects, test for an unexplained mismatch, score findings on held-out days.

A storm index shows that magnetic north moved, but not in which direction: the cause is named, nothing is corrected.
Its significance comes from shifting the index in time, which preserves its storms and their autocorrelation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations import observatory
from compasslib.deviation.model import DeviationFit
from compasslib.effects import Effect
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import DAY_S, HOUR_S, parameter_slices
from compasslib.effects.forward import north_shift
from compasslib.effects.reference import IndexedDisturbance
from compasslib.inference import covariates as covariate_series
from compasslib.inference import design, diagnosis, experiments, finding, heldout, joint, search, sticking
from compasslib.inference.comparison import CANCELS, FEWEST_PAIRS, LongComparison, Options, build_finding
from compasslib.inference.design import FittedModel
from compasslib.inference.diagnosis import Diagnosis, Outcome
from compasslib.inference.evidence import MOST_EFFECTS
from compasslib.inference.finding import BinnedResidual, CovariateRange, Finding, HeldOut, Parameter, Unexplained
from compasslib.inference.noise import REFERENCE_TOO, CurrentStatement
from compasslib.inference.product import AppliedCompass, WeightedCompass
from compasslib.inference.search import Inference
from compasslib.inference.sticking import HeadingCluster
from compasslib.inference.wording import SIZE_PREFIX, TURN_PREFIX
from compasslib.statistics.whitening import correlation_time, sampling_interval_s
from compasslib.types import Floats

FIXED_PLACES = ("middle", "range", "period_s")  # that are not searched for
SLOW = (  # reported parameters of slow noise
    ("slow_rms_deg", "veer", "size"), ("slow_memory_days", "veer", "memory_days"), ("slow_shear_m_s", "shear", "size")
)  # fmt: skip
STORM_SIZES_NT = np.geomspace(0.3, 100.0, 8)  # perpendicular to magnetic north, per unit of ap
STORM_SHIFTS, NEAREST_SHIFT_S = 400, 5 * 86400.0  # shifts of the index in time, and the least one; storms last for days
STORM_BLOCKS = 12  # blocks of a record for the jackknife
STORMY_QUANTILE = 0.9  # quantile of the index from which a time is stormy
STORM_PHYSICS = (
    "magnetic north is unsteady where the index of storms is high; its course only an observatory could tell. "
    "Nothing is corrected by it"
)
NO_SIGMA = 1e-6  # standard error, in any unit, up to which a parameter of value 0 is not listed


def diagnose(comparison: LongComparison, options: Options, fit: DeviationFit | None = None) -> Diagnosis:
    """Diagnose a long record against its simulation; its fit is needed for information that other records share."""
    none = np.zeros(comparison.nuisance.shape[1])
    if (usable := design.count_usable(comparison, comparison.simulation, none)) < FEWEST_PAIRS:
        why = f"the branch of the compass is known for {usable} of {len(comparison)} pairs; {FEWEST_PAIRS} are needed"
        # If hardly any pair agrees with either of its headings, the fit itself is wrong.
        return replace(diagnosis.insufficient(why, comparison.not_testable), refutes_fit=4 * usable < len(comparison))
    try:
        return _diagnose(design.evaluate_model(comparison, comparison.simulation, none), options, fit)
    except design.TooFewSamples as lost:  # initially, or after a refit
        why = f"{lost}; there is nothing to compare the compass with"
        refutes_fit = len(comparison) >= 4 * design.FEWEST_SAMPLES
        return replace(diagnosis.insufficient(why, comparison.not_testable), refutes_fit=refutes_fit)


def _diagnose(initial: FittedModel, options: Options, fit: DeviationFit | None) -> Diagnosis:
    initial, cluster = sticking.exclude_sticking(initial)
    initial = design.refit(initial, [])  # compass and nuisances, accounting for autocorrelation
    inferred = search.infer(initial, options.prior_odds, options.surrogates)
    stormy = storm_finding(inferred.fitted)
    null_model = design.refit(inferred.fitted, []) if inferred.fitted.simulation.terms else inferred.fitted
    diagnosed = diagnosis.combine_outcomes(
        [_outcome(inferred, null_model, cluster, options)],
        options,
        extra=[] if stormy is None else [stormy],
        not_testable=initial.comparison.not_testable,
    )
    covariance = inferred.covariance(null_model)[:5, :5]
    if inferred.slow.current.any():  # effect of the current on the fit
        shift = null_model.simulation.coefficients - null_model.comparison.simulation.coefficients
        covariance = covariance + np.outer(shift, shift)
    return replace(
        diagnosed,
        applied=tuple(_weighted_compass(inferred, *each) for each in inferred.weighted) if options.apply else (),
        covariance=covariance,
        why=_limits_text(inferred.limits),
        detectable_deg=inferred.limits,
        detection=inferred.detections[0],
        prior_odds=options.prior_odds,
        experiments=experiments.rank_observations(inferred) if diagnosed.verdict == "ambiguous" else (),
        information=joint.record_information(inferred, fit) if options.share and fit is not None else None,
    )


def _limits_text(limits: Mapping[str, float | None]) -> str:
    """State the smallest and the largest detection limit; empty without any."""
    known = sorted((size, name) for name, size in limits.items() if size is not None)
    if not known:
        return ""
    least, most = (f"{size:.1f}° rms" for size, _ in (known[0], known[-1]))
    if least == most:
        return f"Any effect that was tried is detected with a probability of 90 % from {least} on."
    first, last = (name.replace("_", " ") for _, name in (known[0], known[-1]))
    return f"Effects are detected with a probability of 90 % from {least} ({first}) to {most} ({last}) on."


def _outcome(inferred: Inference, null_model: FittedModel, cluster: HeadingCluster | None, options: Options) -> Outcome:
    """Collect the outcome of the search."""
    fitted, comparison = inferred.fitted, inferred.fitted.comparison
    covariance, terms = inferred.covariance(fitted), parameter_slices(fitted.simulation.terms, 5)
    findings = tuple(_finding(inferred, k, covariance[x, x], options.surrogates) for k, x in enumerate(terms))
    exceeded, stated = _current(inferred, options.min_effect_deg)
    largest = sorted(findings, key=lambda item: -item.rms_effect_deg)
    named = [item.named for item in largest if item.rms_effect_deg >= options.min_effect_deg]

    def curves(shown: Sequence[Finding], left: Unexplained | None) -> list[BinnedResidual]:
        proofs = ((item.held_out.points, f"{TURN_PREFIX}{item.effect}") for item in shown)
        turns = [replace(points, covariate=name) for points, name in proofs if points is not None]
        named = {item.effect for item in shown}
        steps = [term for term in fitted.simulation.terms if term.dated() and term.name in named]
        along = dict.fromkeys(["heading", "time", *(item.where.covariate for item in shown)])
        names = [name for name in along if name in comparison.covariates and (name != "time" or not steps)]
        sizes = [residual_curve(null_model, fitted, "time", step=term) for term in steps]
        others = [
            residual_curve(null_model, fitted, name)
            for name, x in comparison.covariates.items()
            if name not in along and np.std(x) and not covariate_series.is_like_time(x, comparison.scene.time_s)
        ]
        known = [residual_curve(null_model, fitted, name) for name in names]
        # Of the others, show the one with the largest mean square in standard errors.
        squares = [(curve.after_deg / curve.sigma_deg) ** 2 for curve in others]
        excess = [float(np.mean(square)) if len(square) else 0.0 for square in squares]
        return [*turns, *known, *sizes, *([others[int(np.argmax(excess))]] if others else [])]

    return Outcome(
        comparison=comparison,
        sides=inferred.sides,
        findings=findings,
        chances=inferred.chances,
        left=_unexplained(inferred, cluster, named, options.min_effect_deg),
        small=(),
        curves=curves,
        noise=_summarize_noise(inferred),
        current=stated,
        current_probability=exceeded,
    )


def _summarize_noise(inferred: Inference) -> dict[str, tuple[float, float]]:
    """Estimate the parameters of the noise, each with its standard error."""
    fitted, evidence = inferred.fitted, inferred.further.evidence
    time_s, weight = fitted.comparison.scene.time_s, evidence.noise_probability()
    hours, step = float(np.ptp(time_s)) / HOUR_S, sampling_interval_s(time_s) / HOUR_S
    short = correlation_time(fitted.whitener) * step
    width = fitted.whitener.width_deg
    white = float(np.median(width[np.isfinite(width)]))
    result = {
        "white_deg": (white, white * float(np.sqrt((step + 2.0 * short) / (2.0 * hours)))),
        "short_hours": (short, short * float(np.sqrt(2.0 * (step + short) / hours))),
    }
    for name, process, value in SLOW:
        each = np.array([getattr(getattr(slow_noise, process), value) for slow_noise in evidence.noises])
        mean = float(weight @ each)
        result[name] = (mean, float(np.sqrt(weight @ (each - mean) ** 2)))
    return result


def _current(inferred: Inference, min_effect_deg: float) -> tuple[float, tuple[CurrentStatement, ...]]:
    """Describe the current under the chosen hypothesis, and compute the probability that it matters without effects."""
    model, columns = inferred.model, inferred.model.slow.columns
    turned = model.freed.visible(columns[:, columns.shape[1] - len(model.slow.drivers) :])
    visible = turned.T @ turned / len(turned)  # mean products with the compass projected out, square degrees
    alone = model.current((), model.weigh(inferred.further.evidence.likely_noises).likeliest_noise())
    with_effects = model.current(inferred.entered, inferred.slow_noise)
    exceeded, _ = alone.statements(visible, min_effect_deg)
    stated, series = [], inferred.fitted.comparison.scene.departures
    flow_deg = angles.direction(series["body_flow_sine"], series["body_flow_cosine"])
    aligned = bool(angles.resultant_length(flow_deg) >= covariate_series.FOLLOWS_FLOW)
    for item in with_effects.statements(visible, min_effect_deg, aligned=aligned)[1]:
        if item.driver == "flow_direction" and "reference_sine" not in series:
            item = replace(item, text=item.text + REFERENCE_TOO)
        groups = [group for group in inferred.rivals if item.driver is None or item.driver in group]
        rival = max((inferred.rivals[group] for group in groups), key=lambda each: each.probability, default=None)
        driver = "" if rival is None else model.options[rival.option].term.driver
        stated.append(item if rival is None else item.contested(rival.probability, driver))
    return exceeded, tuple(stated)


def _unexplained(
    inferred: Inference, cluster: HeadingCluster | None, named: Sequence[str], min_effect_deg: float
) -> Unexplained | None:
    """Describe a mismatch beyond the effects that are searched for, or a sector in which the compass sticks."""
    fitted = inferred.fitted
    if cluster is not None and cluster.rms_deg > min_effect_deg:
        low, high = (cluster.recorded_deg + side * cluster.width_deg / 2.0 for side in (-1.0, 1.0))
        place = fitted.comparison.where("heading", (low, high))
        sticks = f", where the compass sticks: its readings accumulate at {cluster.recorded_deg:.0f}°"
        place = replace(place, text=place.text + sticks)
        return fitted.comparison.unexplained([residual_curve(fitted, fitted, "heading")], cluster.rms_deg, named, place)
    model, k = inferred.model, int(np.argmax(inferred.further.probability))
    if len(inferred.chosen) < MOST_EFFECTS or not search.stands_out(inferred.detections[-1], inferred.further):
        return None
    entered = (*inferred.entered, (k, model.likeliest_amplitude(k, inferred.slow_noise, inferred.entered)))
    usual, values = model.options[k].usual, model.fit(entered, inferred.slow_noise)[-1]
    turn = model.options[k].columns @ (values / np.where(usual > 0.0, usual, 1.0))
    size = float(np.sqrt(np.mean(model.freed.visible(turn[:, None]) ** 2)))
    if size < min_effect_deg:
        return None
    along = fitted.comparison.main_covariate(model.options[k].term)
    return fitted.comparison.unexplained([residual_curve(fitted, fitted, along)], size, named)


def _finding(inferred: Inference, k: int, covariance: Floats, surrogates: int) -> Finding:
    fitted = inferred.fitted
    without = design.refit(fitted, [term for j, term in enumerate(fitted.simulation.terms) if j != k])
    term, comparison = fitted.simulation.terms[k], fitted.comparison
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    parameters = {
        name: Parameter(float(value), float(s), comparison.unit(term, j)[1])
        for j, (name, value, s) in enumerate(zip(term.fitted(), term.values, sigma, strict=True))
        if value or s > NO_SIGMA  # e.g. a third battery that was never installed
    }
    if isinstance(term, ComposedEffect):
        parameters |= _place_parameters(inferred, k, term)
    span = _active_span(fitted, term)
    place = comparison.where(comparison.main_covariate(term))
    place = place if span == comparison.span_s else comparison.where("time", span)
    off = angles.difference(fitted.heading_deg, without.heading_deg)
    built = build_finding(
        comparison,
        term,
        {inferred.display_name(name, inferred.places[k]): p for name, p in inferred.chances[k].items()},
        parameters,
        size_deg=design.visible_size_deg(fitted, k, covariance),
        proof=heldout.cross_validate(inferred, k, surrogates),
        place=place,
        span_s=span,
        heading_error_deg=angles.rms(off[np.isfinite(off)]),
        others=without.simulation.terms,
    )
    return replace(built, applied=term.side == "compass")


def _place_parameters(inferred: Inference, k: int, term: ComposedEffect) -> dict[str, Parameter]:
    """Collect the dates and places of a composition, with standard errors from the probabilities of those tried."""
    place, result = inferred.places[k], dict[str, Parameter]()
    alike = place.alike(type(term))
    weight = place.probability[alike] / max(float(place.probability[alike].sum()), 1e-12)
    for each in (each for each in fields(term) if not each.metadata["step"] and each.name not in FIXED_PLACES):
        value, name = float(getattr(term, each.name)), each.name
        off = np.array([float(getattr(inferred.model.options[j].term, name)) for j in alike]) - value
        sigma, unit = float(np.sqrt(weight @ off**2)), inferred.fitted.comparison.driven(term, each.metadata["unit"])
        if unit == "s":
            name, value, sigma, unit = name.replace("_s", "_days"), value / DAY_S, sigma / DAY_S, "days"
        result[name] = Parameter(value, sigma, unit)
    return result


def _active_span(fitted: FittedModel, term: Effect) -> tuple[float, float]:
    """Find the time span in which an effect acts: that of a storm is limited, most others last throughout."""
    scene, always = fitted.comparison.scene, fitted.comparison.span_s
    if set(covariate_series.OBSERVATORY) & set(term.needs):
        moved = north_shift(replace(fitted.simulation, terms=(term,)), scene)
        return observatory.strongest_disturbance(scene.time_s, np.broadcast_to(moved, scene.time_s.shape))
    if isinstance(term, ComposedEffect):
        return term.span(*always)
    if set(covariate_series.TILT_CORRECTIONS) <= set(term.needs):
        leaning = np.flatnonzero(scene.departures[covariate_series.TILT_CORRECTIONS[0]])
        return float(scene.time_s[leaning[0]]), float(scene.time_s[leaning[-1]])
    return always


def _weighted_compass(inferred: Inference, weight: float, fitted: FittedModel) -> WeightedCompass:
    """Extract the compass with the terms on its side; without any term the fit itself applies."""
    terms, compass = fitted.simulation.terms, None
    if terms:
        places = zip(terms, parameter_slices(terms, 5), strict=True)
        index = np.r_[:5, *(columns for term, columns in places if term.side == "compass")]
        simulation = replace(fitted.simulation, terms=tuple(term for term in terms if term.side == "compass"))
        means = covariate_series.reference_values(fitted.comparison.covariates)
        logged = {name for term in simulation.terms for name in term.needs} & means.keys()
        compass = AppliedCompass(
            simulation=simulation,
            covariance=inferred.covariance(fitted)[np.ix_(index, index)],
            references={name: means[name] for name in sorted({*logged, "time"})},
            logged=tuple(sorted(logged)),
        )
    return WeightedCompass(weight, "+".join(term.name for term in terms) or "none", compass)


def residual_curve(
    before: FittedModel, after: FittedModel, covariate: str, *, step: Effect | None = None
) -> BinnedResidual:
    """Bin the residual along a covariate, with and without the terms, excluding samples without a root.

    Args:
        step: a dated term; the residual of each bin is then expressed as the size of this term, rms degrees. The mean
            residual does not show a change of iron, since the sign of its effect depends on the heading.
    """
    x, pattern = before.comparison.covariates[covariate], np.ones(len(before.comparison))
    if step is not None:
        pattern = design.term_columns(before, type(step)()) @ step.values
        pattern = pattern / angles.rms(pattern)
    bins, edges = finding.bins_along(covariate, x)
    finite = np.isfinite(before.whitener.width_deg) & np.isfinite(after.whitener.width_deg)
    filled = np.flatnonzero(np.bincount(bins[finite], minlength=len(edges) - 1) >= finding.FEWEST_IN_BIN)
    (first, _), (second, sigma) = (_binned(fitted, bins, len(edges) - 1, pattern) for fitted in (before, after))
    name, centre = f"{SIZE_PREFIX}{step.name}" if step else covariate, (edges[filled] + edges[filled + 1]) / 2.0
    return BinnedResidual(name, centre, first[filled], second[filled], sigma[filled])


def _binned(fitted: FittedModel, bins: NDArray[np.intp], count: int, pattern: Floats) -> tuple[Floats, Floats]:
    """Regress the residual of each bin on a pattern: coefficients, and standard errors clustered by blocks of days.

    The standard error is at least that from the blocks of all bins pooled: the few blocks of one bin may agree by
    chance, and in null records some bins then deviated by seven of their own standard errors.
    """
    width = fitted.whitener.width_deg
    weight, left = width**-2.0, fitted.standard * np.where(np.isfinite(width), width, 0.0)  # no root: no weight
    total = np.maximum(np.bincount(bins, weight * pattern**2, count), 1e-12)
    mean = np.bincount(bins, weight * pattern * left, count) / total
    time_s = fitted.comparison.scene.time_s
    block = np.floor((time_s - time_s[0]) / finding.RESIDUAL_MEMORY_S).astype(int)
    sums = np.bincount(block * count + bins, weight * pattern * (left - mean[bins] * pattern), (block[-1] + 1) * count)
    squares = np.sum(sums.reshape(-1, count) ** 2, axis=0)
    return mean, np.sqrt(np.maximum(squares, total * squares.sum() / total.sum())) / total


def storm_finding(fitted: FittedModel, alarm: float = 0.006) -> Finding | None:
    """Test whether directions scatter with the storm index; None if they do not, or without an index.

    Args:
        fitted: fitted model with all terms that were found.
        alarm: probability of a false finding from noise alone.
    """
    scene, width = fitted.comparison.scene, fitted.whitener.width_deg
    if (IndexedDisturbance.name, CANCELS) in fitted.comparison.not_testable or "storm_index" not in scene.departures:
        return None
    known = np.isfinite(width) & np.isfinite(fitted.residual_deg)
    index = scene.departures["storm_index"]
    unit = index / scene.horizontal_nT / angles.DEGREE  # degrees for 1 nT per unit of ap
    ratio = np.clip(fitted.residual_deg[known] / width[known], -finding.MOST_WIDTHS, finding.MOST_WIDTHS)
    squares, share = ratio**2, (unit[known] / width[known]) ** 2
    nearest = int(NEAREST_SHIFT_S / max(float(np.median(np.diff(scene.time_s[known]))), 1.0)) + 1
    count = min(STORM_SHIFTS, max(len(share) - 2 * nearest, 1))
    shifts = [0, *np.linspace(nearest, len(share) - nearest, count).astype(int).tolist()] if share.any() else []
    each = [max(np.sum(_storm_gains(x, squares, np.roll(share, k))) for x in STORM_SIZES_NT.tolist()) for k in shifts]
    chance = (1 + int(np.sum(np.array(each[1:]) >= each[0]))) / (1 + count) if each else 1.0
    if chance > alarm:
        return None
    block = np.arange(len(share)) * STORM_BLOCKS // len(share)
    size = _storm_size(squares, share)
    sizes = np.array([_storm_size(squares[block != k], share[block != k]) for k in range(STORM_BLOCKS)])  # jackknife
    gains = np.array([_storm_gains(x, squares, share)[block == k].sum() for k, x in enumerate(sizes.tolist())])
    sigma = float(np.std(sizes) * np.sqrt(STORM_BLOCKS - 1))
    spread, rms_deg = 1.96 * float(np.std(gains) * np.sqrt(STORM_BLOCKS)), angles.rms(fitted.residual_deg[known])
    interval = float(gains.sum()) - spread, float(gains.sum()) + spread
    low, high = np.quantile(index, [STORMY_QUANTILE, 1.0]).tolist()
    return build_finding(
        fitted.comparison,
        IndexedDisturbance(),
        {IndexedDisturbance.name: 1.0},
        {"nT_ap": Parameter(size, sigma, "nT")},
        size_deg=size * angles.rms(unit),
        proof=HeldOut(rms_deg, rms_deg, float(gains.sum()), interval, chance, method="shifts"),
        place=CovariateRange("storm_index", low, high, f"where ap is {low:.0f} to {high:.0f}"),
        span_s=observatory.strongest_disturbance(scene.time_s, index),
        physics=f"{STORM_PHYSICS}; the index at other dates does as well {chance:.1%} of the time",
    )


def _storm_gains(size_nT: float, squares: Floats, share: Floats) -> Floats:
    """Compute the log-likelihood gain of each sample over homogeneous noise, with free noise width, (n,).

    Args:
        size_nT: per unit of ap.
        squares: squared ratio of residual to width, clipped, (n,).
        share: variance for 1 nT per unit of ap, relative to the noise, (n,).
    """
    variance = 1.0 + size_nT**2 * share
    width, even = np.mean(squares / variance), np.mean(squares)
    return np.asarray((squares / even - squares / variance / width - np.log(variance * width / even)) / 2.0)


def _storm_size(squares: Floats, share: Floats) -> float:
    """Find the likeliest size, nT per unit of ap."""
    from scipy.optimize import minimize_scalar

    limits = np.log(STORM_SIZES_NT[[0, -1]])
    likeliest = minimize_scalar(lambda log: -np.sum(_storm_gains(np.exp(log), squares, share)), bounds=limits)
    return float(np.exp(likeliest.x))
