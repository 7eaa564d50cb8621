"""Which terms a short recording calls for: hypotheses of up to three, each refitted, and how probable each is.

What nobody's physics is, an error at a few headings only or for a while only, stands among the hypotheses: a card that
is pulled in one sector looks like lobes, a while astray like a slip.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from compasslib.effects.term import Term
from compasslib.inference import omnibus, posterior, show
from compasslib.inference.comparison import Options
from compasslib.inference.omnibus import Rest
from compasslib.inference.posterior import FAR, MOST_TERMS, SURE, Hypothesis, Posterior, Slot
from compasslib.inference.short_record import fitting, likelihood, local, scan
from compasslib.inference.short_record.channel import Channel
from compasslib.inference.short_record.fitting import FittedTerms
from compasslib.inference.short_record.likelihood import Evidence
from compasslib.inference.short_record.local import LOCAL
from compasslib.types import Floats

LIKELIER = 5.0  # odds of an effect over those of a mooring's: what is swung is suspect, and a name must be surer here
MOST_PARENTS = 6  # hypotheses that are extended by one more effect
MOST_PLACES = 3  # at which a term is refitted
PARAMETER = 1.0  # what a parameter costs at least, in log evidence: what is not tried could not pay for more


@dataclass(frozen=True)
class Tried:
    """One hypothesis, refitted."""

    fitted: FittedTerms
    evidence: Evidence
    share: float  # log of the share of the places that do about as well as the best, of all its terms together


@dataclass(frozen=True)
class NamedEffects:
    """The hypothesis that was chosen, and what else may stand in the place of each of its terms."""

    before: FittedTerms  # the base alone
    fitted: FittedTerms
    found: Posterior
    slots: tuple[Slot, ...]
    alone: dict[str, tuple[float, float]]  # log evidence and visible size of each effect, alone
    rest: Rest  # what it leaves


@dataclass
class Search:
    """Hypotheses of one comparison, tried one after the other."""

    channel: Channel
    alarm: float
    tried: dict[Hypothesis, Tried] = field(default_factory=dict)

    @cached_property
    def kinds(self) -> list[type[Term]]:
        """What can be tested, and what has no name."""
        return [*self.channel.terms, *(kind for kind in LOCAL if kind.fits(self.channel))]

    @cached_property
    def odds(self) -> list[float]:
        """Log odds beforehand of each kind."""
        forms = Counter(kind.name for kind in self.kinds)
        whole = posterior.whole_odds(self.kinds, LIKELIER * self.alarm)
        return [odds - float(np.log(forms[kind.name])) for odds, kind in zip(whole, self.kinds, strict=True)]

    def logs(self, uneven: float = 1.0) -> dict[Hypothesis, float]:
        """Return the log of how likely each hypothesis is, up to a constant, odds beforehand counted."""
        evidence = likelihood.log_evidence(self.channel, [one.evidence for one in self.tried.values()], uneven)
        each = zip(self.tried.items(), evidence.tolist(), strict=True)
        return {key: log + one.share + self.prior(key) for (key, one), log in each}

    def prior(self, one: Hypothesis) -> float:
        """Return the log odds beforehand of a hypothesis."""
        return posterior.joint_odds([self.odds[k] for k in one])

    def run(self) -> None:
        """Try single effects, then pairs and triples of what is likely."""
        bare = fitting.fit(self.channel, ())
        self.tried[()] = Tried(bare, likelihood.of(bare), 0.0)
        for size in range(MOST_TERMS):
            logs = self.logs()
            parents = sorted((one for one in self.tried if len(one) == size), key=logs.__getitem__)[-MOST_PARENTS:]
            for parent in reversed(parents):
                self._extended(parent)

    def _extended(self, parent: Hypothesis) -> None:
        """Try every other effect beside those of a hypothesis, refitted where it promises enough."""
        base, logs = self.tried[parent].fitted, self.logs()
        law = likelihood.likeliest(self.channel, self.tried[parent].evidence)
        taken = {self.kinds[k].name for k in parent}
        for k, kind in enumerate(self.kinds):
            hypothesis = tuple(sorted((*parent, k)))
            terms = local.places(base, kind)
            if kind.name in taken or hypothesis in self.tried or not terms:
                continue
            columns = local.columns(base, terms)
            gains, plain = (likelihood.gains(base, one, columns) for one in (law, likelihood.WHITE[0]))
            promised = logs[parent] + float(gains.max()) - PARAMETER * len(kind.fitted()) + self.odds[k]
            if parent and promised < max(logs.values()) - FAR:
                continue
            tried = self._placed(base, terms, columns, plain)
            fitted = tried.fitted.reordered(np.argsort((*parent, k)).tolist())
            self.tried[hypothesis] = Tried(fitted, tried.evidence, self.tried[parent].share + tried.share)

    def _placed(self, base: FittedTerms, terms: list[Term], columns: Floats, gains: Floats) -> Tried:
        """Return a hypothesis with one more term at its best place: by the memory that is left once it is there.

        Args:
            gains: of each place as if there were no memory: what is left out looks like a long one.
        """
        best: int | None = None
        for _ in range(MOST_PLACES):
            if best == int(np.argmax(gains)):
                break
            best = int(np.argmax(gains))
            fitted = self._refitted(base, terms[best])
            evidence = likelihood.of(fitted)
            gains = likelihood.gains(base, likelihood.likeliest(self.channel, evidence), columns)
        return Tried(fitted, evidence, float(np.log(np.mean(np.exp(gains - gains.max())))))

    def _refitted(self, base: FittedTerms, term: Term) -> FittedTerms:
        """Return a hypothesis with one more term, from each value where its fit may begin."""
        starts = [np.append(first, term.values[1:]) for first in self.channel.starts.get(term.name, ())]
        some = [fitting.fit(self.channel, (*base.terms, term.at(v)), near=base) for v in (term.values, *starts)]
        return _finer(min(some, key=lambda one: one.square))

    def posterior(self) -> Posterior:
        """Return how probable each hypothesis is, by noise as uneven as blocks of the likeliest one's residual."""
        logs = self.logs()
        plausible = [key for key, one in self.tried.items() if all(t.plausible for t in one.fitted.terms)]
        best = self.tried[max(plausible, key=logs.__getitem__)]
        law = likelihood.likeliest(self.channel, best.evidence)
        alone = [self.tried[(k,)].fitted.terms[0] for k in range(len(self.kinds)) if (k,) in self.tried]
        slow = [local.columns(best.fitted, [term.at(0.0 * term.values)])[:, 0] for term in alone]
        logs = self.logs(likelihood.uneven(best.fitted, law, slow))
        some = np.array([logs[key] for key in plausible])
        probability = np.exp(some - some.max())
        prior = np.array([self.prior(key) for key in plausible])
        return Posterior([kind.name for kind in self.kinds], plausible, probability / probability.sum(), prior)

    def alone(self) -> dict[str, tuple[float, float]]:
        """Return log evidence and visible size of each effect beside the base alone, the best first."""
        sizes: dict[str, tuple[float, float]] = {}
        logs = self.logs()
        for one in sorted((one for one in self.tried if len(one) == 1), key=logs.__getitem__, reverse=True):
            score = logs[one] - self.prior(one) - logs[()]
            sizes.setdefault(self.kinds[one[0]].name, (score, fitting.effect_deg(self.tried[one].fitted, 0)))
        return sizes


def search(channel: Channel, options: Options) -> NamedEffects:
    """Return the terms that the comparison calls for, each with all that may stand in its place."""
    made = Search(channel, options.alarm)
    made.run()
    found = made.posterior()
    chosen = found.of_at_least(SURE)
    fitted = made.tried[chosen].fitted
    slots = tuple(found.slots(chosen, instead=None))
    tested = scan.test(fitted, fitted, scan.groups(fitted), seed=99)
    rest = omnibus.rest(tested, options.alarm, partial(scan.size_of, fitted), options.min_effect_deg)
    return NamedEffects(made.tried[()].fitted, fitted, found, slots, made.alone(), rest)


def _finer(fitted: FittedTerms) -> FittedTerms:
    """Return a hypothesis with the places of its last term looked for among the samples between those tried."""
    term = fitted.terms[-1]
    near = [one.at(term.values) for one in local.places(fitted, type(term), near=term)]
    squares = [_square_at(fitted, one) for one in near]
    if not squares or min(squares) >= fitted.square:
        return fitted
    better = near[int(np.argmin(squares))]
    return fitting.fit(fitted.channel, (*fitted.terms[:-1], better), near=fitted)


def _square_at(fitted: FittedTerms, last: Term) -> float:
    residual = fitted.channel.residual(fitted.base, (*fitted.terms[:-1], last))
    return float(np.sum(np.minimum(np.abs(residual), show.FARTHEST * fitted.scale_deg) ** 2))
