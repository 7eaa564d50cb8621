"""Linear Gaussian model of a long recording: all options beside slow noise, their evidence, and surrogates.

    y = base b + slow noise c + options w + white noise,   w ~ N(0, a^2) in units of each option, c ~ N(0, variances)

Options are the effects of the catalogue and, per target and driver, a few composed forms, linearized at a fitted model.
Products of the whitened columns with each other and with the residual are sufficient for every hypothesis (Bishop,
Pattern Recognition and Machine Learning, 2006, section 3.5). Amplitudes a and parameters of slow noise are marginalized
over grids. Surrogates are further residuals, drawn from the noise: only their products with the columns are needed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_blas_funcs, solve_triangular

from compasslib.effects import Effect, Scene
from compasslib.effects.composed import (
    DRIVERS,
    LOBES,
    TARGETS,
    TIDE_S,
    ComposedEffect,
    compose_effect,
    driver_series,
    place_effect,
)
from compasslib.effects.effect import DAY_S
from compasslib.effects.readout import CompassLag
from compasslib.effects.reference import ReferenceSlip
from compasslib.inference import covariates, design
from compasslib.inference.design import FittedModel
from compasslib.inference.evidence import (
    DATE_MARGIN,
    MOST_DATES,
    NEGLIGIBLE,
    Evidence,
    Option,
    block_of,
    log_bayes_factors,
    log_sum,
    scale_option,
    with_shares,
)
from compasslib.inference.noise import PLAYS, CurrentPosterior, SlowNoise, SlowNoiseBasis, infer_current
from compasslib.statistics.resampling import EVEN_BLOCKS, blocks_by_span, cluster_variance_inflation
from compasslib.statistics.whitening import sampling_interval_s, whitened_basis
from compasslib.types import Floats

AMPLITUDES_DEG = np.array([0.5, 1.0, 2.0, 4.0, 8.0])  # rms of an effect, equally probable
BLOCK_S = 3 * DAY_S  # longer than the autocorrelation that the filter leaves
FAINT = 1e-3  # variance over that of white noise below which a column of slow noise is left out

VALUES = ("temperature", "depth", "speed", "pitch", "roll", "tilt", "voltage")
WITH_HISTORY = ("temperature", "depth", "voltage")  # whose effects may lag behind them; so does the current by speed
OF_FIELD = ("time", "temperature", "depth", "speed", "pitch", "roll", "voltage")  # may magnetize iron, or move it
OF_LOBES = ("time", "temperature", "depth", "speed", "voltage")  # may bend a sensor's axes, or change their gain
# Magnetization in a new field grows with the logarithm of time (Street and Woolley, Proc. Phys. Soc. A 62, 562, 1949).
CREEPS_S = (1 * DAY_S, 10 * DAY_S, 100 * DAY_S)
BOX_LENGTHS, BOX_STEP = (0.08, 0.16), 0.08  # of temporary offsets, as shares of the record
LISTED = {  # compositions that classes of the catalogue represent
    *(("field_horizontal", driver, "linear") for driver in ("time", "temperature", "voltage")),
    *(("reading", driver, "linear") for driver in ("time", "temperature", "voltage", "turn_rate")),
}

COARSEST_S = 10 * DAY_S  # least first spacing of dates
MOST_PLACES, CLOSE_S = 2, 12 * DAY_S  # places that are refined, and their least distance
STEEP = 1.0  # difference in log likelihood between neighbouring dates from which dates are tried between them
RULED_OUT = -50.0  # log likelihood ratio of what cannot be
LEAST_TURN_DEG = 1e-9  # rms, below which columns are left out

Entered = Sequence[tuple[int, float]]  # index and amplitude, degrees, of options that are part of the noise


@dataclass(frozen=True)
class Products:
    """Products of whitened columns with each other and with residuals: those of the options first, then of noise."""

    information: Floats  # (m, m)
    score: Floats  # (m, r)
    ends: NDArray[np.intp]  # (g + 1,) boundaries between the columns of the options
    amplitudes: Floats  # (a, g) prior rms of each option, degrees, equally probable

    @cached_property
    def of_options(self) -> Floats:
        """Products of the columns with those of the options, (m, p), in the precision of the columns."""
        return self.information[:, : self.ends[-1]].astype(np.float32)

    def columns(self, option: int) -> NDArray[np.intp]:
        """Indices of an option's columns."""
        return np.arange(self.ends[option], self.ends[option + 1])

    def marginalize(self, variance: Floats, entered: Entered = ()) -> Marginal:
        """Marginalize the columns of noise, with given prior variances, and the entered options."""
        active = np.flatnonzero(variance * np.diag(self.information)[self.ends[-1] :] > FAINT)
        at = np.concatenate([self.ends[-1] + active, *(self.columns(k) for k, _ in entered)])
        sizes = (np.full(len(self.columns(k)), size) for k, size in entered)
        root = np.concatenate([np.sqrt(variance[active]), *sizes])
        precision = np.eye(len(root)) + root[:, None] * self.information[np.ix_(at, at)] * root
        return Marginal(self, at, root, np.linalg.cholesky(precision))


@dataclass(frozen=True)
class Marginal:
    """Products with some columns marginalized."""

    products: Products
    at: NDArray[np.intp]  # the marginalized columns
    root: Floats  # square roots of their prior variances
    lower: Floats  # Cholesky factor of their posterior precision, in units of these

    def half(self, columns: Floats) -> Floats:
        """Compute the part of products, (m, k), that the marginalized columns take, as a square root, (a, k)."""
        root, lower = (x.astype(columns.dtype, copy=False) for x in (self.root, self.lower))
        (solve,) = get_blas_funcs(["trsm"], [columns])  # transposed, so that nothing is copied
        return np.asarray(solve(1.0, lower.T, (root[:, None] * columns[self.at]).T, side=1).T)

    @cached_property
    def taken(self) -> Floats:
        """The part of the products with the residuals, (a, r)."""
        return self.half(self.products.score)

    @property
    def mean(self) -> Floats:
        """Posterior means of the coefficients of the marginalized columns for the first residual, (a,)."""
        unit = solve_triangular(self.lower, self.taken[:, 0], lower=True, trans="T", check_finite=False)
        return np.asarray(self.root * unit)

    def left(self, at: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Compute the products of some columns with each other, (k, k), and with the residuals, (k, r)."""
        half = self.half(self.products.information[:, at])
        information = self.products.information[np.ix_(at, at)] - half.T @ half
        return information, self.products.score[at] - half.T @ self.taken

    def fit(self, chosen: Entered) -> Floats:
        """Compute the posterior mean of the coefficients of some options together, (k, r)."""
        at = np.concatenate([self.products.columns(k) for k, _ in chosen])
        size = np.concatenate([np.full(len(self.products.columns(k)), a) for k, a in chosen])
        information, score = self.left(at)
        precision = np.eye(len(at)) + size[:, None] * information * size
        return np.asarray(size[:, None] * np.linalg.solve(precision, size[:, None] * score))

    @cached_property
    def cross(self) -> Floats:
        """The part of the products with the options, (a, p), in the precision of the columns."""
        return self.half(self.products.of_options)

    @cached_property
    def _options(self) -> list[tuple[NDArray[np.intp], Floats, Floats]]:
        """Options of each number of columns: eigenvalues, (g, k), and squared scores along them, (g, k, r)."""
        ends, result = self.products.ends, list[tuple[NDArray[np.intp], Floats, Floats]]()
        cross = self.cross
        left = (self.products.score[: ends[-1]] - cross.T @ self.taken.astype(np.float32)).astype(np.float32)
        sizes = np.diff(ends)
        for size in np.unique(sizes):
            options = np.flatnonzero(sizes == size)
            index = ends[options][:, None] + np.arange(size)
            part = cross[:, index.ravel()].T.reshape(*index.shape, len(self.at))
            information = self.products.information[index[:, :, None], index[:, None, :]]
            values, vectors = np.linalg.eigh(information - part @ part.transpose(0, 2, 1))
            along = (vectors.transpose(0, 2, 1).astype(np.float32) @ left[index]) ** 2
            result.append((options, np.maximum(values, 0.0), along))
        return result

    @cached_property
    def by_amplitude(self) -> Floats:
        """Log Bayes factor of each option over none at each amplitude, (a, g, r)."""
        result = np.empty((*self.products.amplitudes.shape, self.products.score.shape[1]), dtype=np.float32)
        for options, values, along in self._options:
            result[:, options] = log_bayes_factors(values, along, self.products.amplitudes[:, options, None])
        return result

    @property
    def evidence(self) -> Floats:
        """Log Bayes factor of each option over none, (g, r)."""
        return log_sum(self.by_amplitude) - np.log(len(self.products.amplitudes), dtype=np.float32)

    @property
    def none(self) -> Floats:
        """Log likelihood without options, relative to white noise, (r,)."""
        return np.asarray(0.5 * np.sum(self.taken**2, axis=0) - np.sum(np.log(np.diag(self.lower))))


@dataclass(frozen=True)
class LinearModel:
    """All options and slow noise, linearized at a fitted model; p columns of options, then q of slow noise."""

    freed: FittedModel  # whose whitener excludes slow noise
    options: tuple[Option, ...]
    slow: SlowNoiseBasis
    white: Floats  # (n, p + q) float32 whitened columns, in units of the white noise
    scatter: float  # variance of the scores between blocks of days over that of homogeneous noise

    @cached_property
    def residual(self) -> Floats:
        """Whitened residual in units of the white noise, (n,) float32."""
        return (self.freed.innovation / self.freed.sigma / np.sqrt(self.scatter)).astype(np.float32)

    @cached_property
    def products(self) -> Products:
        """Products of the columns with each other and with the residual."""
        ends = np.cumsum([0, *(option.columns.shape[1] for option in self.options)])
        information, score = self.white.T @ self.white, self.white.T @ self.residual[:, None]
        sized = np.array([option.sized for option in self.options], dtype=bool)
        amplitudes = np.where(sized, 1.0, AMPLITUDES_DEG[:, None])
        return Products(information.astype(float), score.astype(float), ends, amplitudes)

    def marginalized(self, slow_noise: SlowNoise, entered: Entered = ()) -> Marginal:
        """Marginalize slow noise and the entered options."""
        return self.products.marginalize(self.slow.variances(slow_noise), entered)

    def weigh(self, slow_noises: Sequence[SlowNoise], entered: Entered = (), score: Floats | None = None) -> Evidence:
        """Compute the evidence of each option beside the entered ones; the scores are the recording's by default."""
        products = self.products if score is None else replace(self.products, score=score)
        each = [products.marginalize(self.slow.variances(slow_noise), entered) for slow_noise in slow_noises]
        none, factors = zip(*((marginal.none, marginal.evidence) for marginal in each), strict=True)
        prior = np.array([[slow_noise.log_prior] for slow_noise in slow_noises])
        return Evidence(self.options, tuple(slow_noises), prior, np.array(none), np.array(factors))

    def likeliest_noise(self, slow_noises: Sequence[SlowNoise], entered: Entered = ()) -> SlowNoise:
        """Select the likeliest slow noise beside the entered options, without weighing further ones."""
        logs = [each.log_prior + float(self.marginalized(each, entered).none[0]) for each in slow_noises]
        return slow_noises[int(np.argmax(logs))]

    def draw(
        self, evidence: Evidence, count: int, seed: int, entered: Entered = (), residual: Floats | None = None
    ) -> Floats:
        """Draw whitened residuals of the recording without further effects, (n, count) float32.

        Args:
            evidence: of the recording, by whose probabilities slow noise is drawn.
            residual: the recording's own without any effect, (n,), whose blocks get random signs, in place of simulated
                noise: the wild cluster bootstrap (Cameron, Gelbach and Miller, Rev. Econ. Stat. 90, 414, 2008).
        """
        rng = np.random.default_rng(seed)
        if residual is not None:
            block = blocks_by_span(self.freed.comparison.scene.time_s, BLOCK_S)
            sign = rng.choice(np.array([-1.0, 1.0], dtype=np.float32), (block[-1] + 1, count))
            surrogates: Floats = residual[:, None] * sign[block]
        else:
            chosen = rng.choice(len(evidence.noises), count, p=evidence.noise_probability())
            deviations = np.sqrt([self.slow.variances(slow_noise) for slow_noise in evidence.noises]).T
            slow = rng.normal(size=(len(deviations), count)) * deviations[:, chosen]
            surrogates = self.white[:, self.products.ends[-1] :] @ slow.astype(np.float32)
            surrogates += rng.normal(size=surrogates.shape).astype(np.float32)
        surrogates[~np.isfinite(self.freed.whitener.width_deg)] = 0.0
        for k, size in entered:
            at = self.products.columns(k)
            surrogates += self.white[:, at] @ (size * rng.normal(size=(len(at), count))).astype(np.float32)
        return self.freed.project_out_nuisance(surrogates)

    def without(self, chosen: Entered, slow_noise: SlowNoise) -> Floats:
        """Subtract some options and the current, fitted together, from the whitened residual, (n,) float32."""
        marginal = self.marginalized(slow_noise, chosen)
        slow = self.white.shape[1] - len(self.slow.drivers)
        taken = (marginal.at < self.products.ends[-1]) | (marginal.at >= slow)
        return self.residual - self.white[:, marginal.at[taken]] @ marginal.mean[taken].astype(np.float32)

    def scores(self, residuals: Floats) -> Floats:
        """Compute the products of the columns with whitened residuals, (n, r)."""
        return (self.white.T @ residuals).astype(float)

    def fit(self, chosen: Entered, slow_noise: SlowNoise) -> list[Floats]:
        """Compute the posterior means of the parameters of some options together, in the terms' units."""
        if not chosen:
            return []
        mean = self.marginalized(slow_noise).fit(chosen)[:, 0]
        ends = np.cumsum([len(self.products.columns(k)) for k, _ in chosen])[:-1]
        return [x * self.options[k].usual for x, (k, _) in zip(np.split(mean, ends), chosen, strict=True)]

    def current(self, chosen: Entered, slow_noise: SlowNoise) -> CurrentPosterior:
        """Infer the drivers of the current beside some options."""
        at = np.arange(self.white.shape[1] - len(self.slow.drivers), self.white.shape[1])
        variance = self.slow.without_current(self.slow.drivers).variances(slow_noise)
        information, score = self.products.marginalize(variance, chosen).left(at)
        return infer_current(self.slow.drivers, information, score[:, 0])

    def likeliest_amplitude(self, option: int, slow_noise: SlowNoise, entered: Entered = ()) -> float:
        """Find the likeliest amplitude of an option, degrees."""
        by_amplitude = self.marginalized(slow_noise, entered).by_amplitude
        return float(self.products.amplitudes[int(np.argmax(by_amplitude[:, option, 0])), option])


def linearize(fitted: FittedModel, slow: SlowNoiseBasis) -> LinearModel:
    """Linearize all options at a fitted model, whose terms are freed, and compute the products of their columns."""
    freed, midpoint = design.freed_model(fitted)
    options = enumerate_options(freed, midpoint)
    columns = np.concatenate([*(option.columns for option in options), slow.columns], axis=1, dtype=np.float32)
    scatter = _score_inflation(fitted, options)
    sigma = freed.sigma * np.sqrt(scatter)
    white = freed.whiten_and_project(columns) * np.float32(freed.response / sigma)
    return LinearModel(freed, options, slow, white, scatter)


def _score_inflation(fitted: FittedModel, options: Sequence[Option]) -> float:
    """Estimate by how much scores vary more between blocks of days than homogeneous noise explains, at least 1.

    Real directions scatter more in some weeks than their widths imply: the median of a cluster-robust variance over the
    blocks (Liang and Zeger, Biometrika 73, 13, 1986).
    """
    first = list({option.block: option for option in reversed(options)}.values())
    white = fitted.whiten_and_project(np.concatenate([option.columns for option in first], axis=1))
    block = blocks_by_span(fitted.comparison.scene.time_s, BLOCK_S)
    ends = np.cumsum([option.columns.shape[1] for option in first])[:-1]
    inflation, count = [], []
    for part in np.split(white, ends, axis=1):
        basis = whitened_basis(part).astype(float)
        if basis.shape[1]:
            each = cluster_variance_inflation(basis, fitted.innovation, block, fitted.sigma**2)
            inflation.append(each[0])
            count.append(each[1])
    weight = np.array(count) / (np.array(count) + EVEN_BLOCKS)
    order = np.argsort(inflation)
    middle = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2.0)
    return max(float(np.array(inflation)[order][middle]), 1.0) if len(order) else 1.0


def enumerate_options(freed: FittedModel, midpoint: FittedModel) -> tuple[Option, ...]:
    """Enumerate the forms of all blocks, linearized at a midpoint; the residual of the freed model dates steps."""
    made = _rule_out_early([*_listed(freed, midpoint), *_composed(midpoint)], freed)
    turns = midpoint.comparison.reference_turns
    return tuple(
        replace(each, log_ratio=_turn_ratio(each.term, turns)) if turns and type(each.term).dated() else each
        for each in with_shares([option for option in made if option.columns.shape[1]])
    )


def _rule_out_early(options: list[Option], freed: FittedModel) -> list[Option]:
    """Rule out what depends on the rate of turn if the readings are ahead of the headings.

    A compass is late. Directions are ahead of the turns where the flow around the instrument, which the reference does
    not see, turns it.
    """
    entered = {type(term) for term in freed.simulation.terms}
    for lag in (option for option in options if type(option.term) is CompassLag):
        if float(freed.whiten_and_project(lag.columns)[:, 0] @ freed.innovation) < 0.0:
            ruled = (each.block == lag.block and type(each.term) not in entered for each in options)
            return [
                replace(each, log_ratio=RULED_OUT) if out else each for each, out in zip(options, ruled, strict=True)
            ]
    return options


def _turn_ratio(term: Effect, turns: tuple[Floats, Floats]) -> float:
    """Compute by how much the reference's directions contradict a step of the reference, or of the compass.

    They never count for a step, as a change of the water turns them too.
    """
    ratio = float(np.interp(term.date, *turns))
    return min(ratio if isinstance(term, ReferenceSlip) else -ratio, 0.0)


def _listed(freed: FittedModel, midpoint: FittedModel) -> Iterator[Option]:
    """Yield the effects of the catalogue, dated ones at each date; effects of the water are part of the noise."""
    for kind in (kind for kind in midpoint.comparison.terms if kind.side != "water"):
        if not kind.dated():
            yield linear_option(midpoint, kind())
            continue
        derivative = design.term_columns(midpoint, kind())
        known = [term.date for term in midpoint.simulation.terms if type(term) is kind]
        since = midpoint.comparison.scene.since
        for date, share in zip(*(x.tolist() for x in search_dates(freed, derivative, known)), strict=True):
            term = replace(kind(), date_s=date)  # type: ignore[call-arg]
            yield linear_option(midpoint, term, derivative * since(date)[:, None], share)


def _composed(midpoint: FittedModel) -> Iterator[Option]:
    """Yield the forms that the catalogue does not list."""
    scene = midpoint.comparison.scene
    acted = {
        target: design.term_columns(midpoint, compose_effect(target, "time", "always")())
        for target, place in TARGETS.items()
        if place.side != "water"
    }
    listed = {kind.composition for kind in midpoint.comparison.terms if issubclass(kind, ComposedEffect)} | LISTED
    for target, driver, form, *places in _compositions(scene, midpoint.comparison.units):
        for at in () if (target, driver, form) in listed else places or [()]:
            term = place_effect(compose_effect(target, driver, form), *at)
            series = term.evaluate(scene, midpoint.comparison.recorded_deg)
            columns = (acted[target][:, :, None] * series[:, None, :]).reshape(len(series), -1)
            yield linear_option(midpoint, term, columns, 1.0 / max(len(places), 1))


def _compositions(scene: Scene, channels: Mapping[str, str]) -> Iterator[tuple]:
    """Yield target, driver, form and the places that are tried of each composition."""
    time_s = scene.time_s
    first, last = float(time_s[0]), float(time_s[-1])
    there = [driver for driver in (*VALUES, *channels) if _varies(scene, driver)]
    for driver in there:
        x = driver_series(scene, driver)
        middle, width = float(np.median(x)), float(np.std(x))
        forms = [("linear",), ("memory", *((play * width,) for play in PLAYS))]
        forms += [] if covariates.is_like_time(x, time_s) else [("smooth", (middle, width))]
        forms += [("bands",)] if driver in WITH_HISTORY or driver in channels else []
        targets = ["reading"] + ["field_horizontal"] * (driver in OF_FIELD)
        yield from ((target, driver, *form) for target in targets for form in forms)
        yield from ((target, driver, "linear") for target in (*LOBES, "field_down") if driver in OF_LOBES)
    if _varies(scene, "turn_rate"):
        yield "reading", "turn_rate", "sign"
        yield "reading", "turn_rate", "smooth", (0.0, float(np.std(driver_series(scene, "turn_rate"))))
    for target in ("reading", "field_horizontal"):
        yield target, "time", "linear"
        yield target, "time", "slow", (first, last)
        yield target, "time", "creep", *((first, x) for x in CREEPS_S), *((last, -x) for x in CREEPS_S)
        yield target, "hour", "periodic", (DAY_S,)
        yield target, "hour", "daily"
        yield target, "tide", "periodic", (TIDE_S,)
        yield target, "tide", "tidal"
    yield "field_horizontal", "time", "free", (first, last)
    yield from ((target, "time", "linear") for target in (*LOBES, "field_down"))
    begins = np.arange(BOX_STEP / 2.0, 1.0 - BOX_STEP, BOX_STEP)
    spans = [(begin, begin + length) for length in BOX_LENGTHS for begin in begins if begin + length < 1.0]
    yield "reading", "time", "box", *((first + (last - first) * a, first + (last - first) * b) for a, b in spans)
    yield "reading", "heading", "harmonics"
    yield "reading", "heading", "teeth"
    joined = sorted([*(driver for driver in there if driver in VALUES and driver != "tilt"), "time"])
    yield from (("reading", f"{a}*{b}", "linear") for a, b in itertools.combinations(joined, 2))


def _varies(scene: Scene, driver: str) -> bool:
    name = DRIVERS[driver][0] if driver in DRIVERS else driver
    if name not in scene.departures:
        return False
    sample = scene.departures[name][:: max(len(scene) // 500, 1)]
    return len(np.unique(sample)) >= covariates.FEWEST_VALUES


def linear_option(midpoint: FittedModel, term: Effect, derivative: Floats | None = None, cell: float = 1.0) -> Option:
    """Linearize one effect at a fitted model, in units of its expected size if physics gives one."""
    derivative = design.term_columns(midpoint, term) if derivative is None else derivative
    with np.errstate(divide="ignore"):
        expected = type(term).expected() ** -0.5
    if np.all(np.isfinite(expected)):
        return Option(term, block_of(type(term)), (derivative * expected).astype(np.float32), expected, True, cell)
    turn = np.std(derivative, axis=0)
    option = scale_option(term, derivative, turn, LEAST_TURN_DEG * max(float(turn.max(initial=0.0)), 1.0), cell)
    return replace(option, columns=option.columns.astype(np.float32))


def search_dates(freed: FittedModel, derivative: Floats, known: Sequence[float] = ()) -> tuple[Floats, Floats]:
    """Choose the dates at which a step is tried, coarse to fine, and the share of the record that each represents.

    Where the likelihood changes steeply between dates ten days apart, days and then samples are tried between them.

    Args:
        derivative: columns of the step's effect throughout, (n, k) degrees per unit.
        known: dates that are tried in any case.
    """
    time_s = freed.comparison.scene.time_s
    step = sampling_interval_s(time_s)
    low, high = np.quantile(time_s, [DATE_MARGIN, 1.0 - DATE_MARGIN])
    coarse = np.union1d(np.arange(low, high, max(COARSEST_S, (high - low) / MOST_DATES)), known)
    gains = _step_gains(freed, derivative)
    dates, gain = coarse, gains(coarse)
    for spacing in (DAY_S, step):
        places: list[int] = []
        for k in np.argsort(-gain).tolist():
            if len(places) < MOST_PLACES and all(abs(dates[k] - dates[other]) > CLOSE_S for other in places):
                places.append(k)
        between = [np.zeros(0)]
        for k in places:
            left, right = max(k - 1, 0), min(k + 1, len(dates) - 1)
            if gain[k] - min(gain[left], gain[right]) >= STEEP:
                inside = time_s[(time_s > dates[left]) & (time_s < dates[right])] - step / 2.0
                between.append(inside if spacing == step else np.arange(dates[left] + spacing, dates[right], spacing))
        if len(new := np.setdiff1d(np.concatenate(between), dates)):
            dates, gain = np.append(dates, new), np.append(gain, gains(new))
            order = np.argsort(dates)
            dates, gain = dates[order], gain[order]
    kept = np.isin(dates, coarse) | (gain > gain.max() - NEGLIGIBLE)
    dates = dates[kept]
    edges = np.concatenate([[time_s[0]], (dates[1:] + dates[:-1]) / 2.0, [time_s[-1]]])
    return dates, np.diff(edges) / float(np.ptp(time_s))


def _step_gains(freed: FittedModel, derivative: Floats) -> Callable[[Floats], Floats]:
    """Return a function that computes the gain in log likelihood by a step at each of several dates, (d,)."""
    scale = np.std(derivative, axis=0)
    unit = (derivative / np.where(scale > 0.0, scale, 1.0)).astype(np.float32)
    target = (freed.innovation / freed.sigma).astype(np.float32)

    def gains(dates_s: Floats) -> Floats:
        since = (freed.comparison.scene.time_s[:, None] >= dates_s).astype(np.float32)
        steps = (unit[:, None, :] * since[:, :, None]).reshape(len(unit), -1)
        white = freed.whiten_and_project(steps).reshape(len(unit), len(dates_s), -1) * np.float32(
            freed.response / freed.sigma
        )
        information = np.einsum("ndi,ndj->dij", white, white, optimize=True).astype(float)
        score = np.einsum("ndi,n->di", white, target, optimize=True).astype(float)
        ridge = np.eye(unit.shape[1]) * np.maximum(1e-6 * np.trace(information, axis1=1, axis2=2), 1e-12)[:, None, None]
        return np.asarray(
            0.5 * np.sum(score * np.linalg.solve(information + ridge, score[:, :, None])[:, :, 0], axis=1)
        )

    return gains
