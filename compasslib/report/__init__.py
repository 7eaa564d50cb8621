"""Report of a whole cruise, results/report.html: one page that needs no network, server or other file.

Results are read and described in sentences and tables (``sections`` with the templates ``*.txt``) and rendered by the
templates ``*.html``, which escape all texts.

Numbers are formatted with their uncertainty:

>>> from compasslib.report import words
>>> words.with_sigma(-12.3456, 0.21, "°").replace(words.SPACE, " ")
'−12.35 ± 0.21°'
>>> words.degrees(float("nan"))  # what is not known is a dash
'–'
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compasslib.archive import provenance
from compasslib.archive.files import atomic_write
from compasslib.archive.summary import STOPPED
from compasslib.inference.wording import VERDICTS
from compasslib.plots.figures import CRUISE, MOORING, SECTIONS
from compasslib.report import words
from compasslib.report.results import (
    MAX_SECTIONS,
    Overview,
    ReportFigure,
    ReportTable,
    collect_figures,
    read_calibration,
    read_mooring,
    read_summary,
    stopped_section,
)
from compasslib.report.sections import calibration_section, compass_section, mooring_section

MOORINGS = "All moorings; σ: median standard uncertainty of the headings; error removed: rms of their correction"
DEPLOYMENTS = "Deployments; instruments with format and nominal depth"
COEFFICIENTS = "Coefficients of the compasses ± 1σ, dimensionless for the exact compass"
CALIBRATIONS, COMPASSES = "All calibrations", "All compasses that several records share"
REPORT, STYLE = Path(__file__).resolve().parent, "templates/style.css"
NONE_STOPPED: Mapping[str, Mapping[str, str]] = {"moorings": {}, "calibrations": {}}
NO_COMPASSES = Overview(COMPASSES, (), ())


@dataclass(frozen=True)
class Report:
    """Content of the page."""

    title: str
    attributes: tuple[tuple[str, str], ...]
    moorings: Overview
    calibrations: Overview
    software: str
    date: str
    figures: tuple[ReportFigure, ...] = ()  # figures of all moorings together
    small: bool = False  # whether there are too many sections for embedded figures
    compasses: Overview = NO_COMPASSES
    concealed: tuple[str, ...] = ()  # moorings whose errors the processing was not told
    tables: tuple[ReportTable, ...] = ()  # deployments, and coefficients of the compasses
    notes: tuple[tuple[str, str], ...] = ()  # how the figures of moorings are read, by title
    missing: tuple[str, ...] = ()  # global attributes that the YAML files do not give for some mooring

    def counts(self) -> str:
        """Count moorings by verdict, calibrations and shared compasses."""
        verdicts = [section.verdict for section in self.moorings.sections]
        known = [verdict for verdict in (*VERDICTS, STOPPED) if verdict in verdicts]
        each = [f"{verdicts.count(verdict)} {verdict}" for verdict in known]
        by_verdict = f", {'all ' * (len(verdicts) > 1)}{known[0]}" if len(known) == 1 else f" ({', '.join(each)})"
        parts = ((self.moorings, "mooring"), (self.calibrations, "calibration"), (self.compasses, "shared compass"))
        numbers = [
            words.plural(len(part.sections), noun, "shared compasses" if noun == "shared compass" else None)
            + by_verdict * (noun == "mooring" and bool(known))
            for part, noun in parts
            if part.sections
        ]
        return f"{'; '.join(numbers)}."


def gather(
    root: str | Path,
    *,
    attributes: Mapping[str, Any],
    moorings: Mapping[str, Mapping[str, Any]],
    calibrations: Sequence[str],
    compasses: Sequence[str] = (),
    stopped: Mapping[str, Mapping[str, str]] = NONE_STOPPED,
) -> Report:
    """Compose the content of the page from the results.

    Args:
        root: folder of the results, to which links on the page are relative.
        moorings: latitude, longitude, water_depth_m, start, end, instruments and their roles, by name of the mooring.
        stopped: reasons why there are no results, by name, for ``moorings`` and for ``calibrations``.

    Raises:
        InputError: if a result file is missing or damaged.
    """
    root = Path(root)
    rows = read_summary(root / "summary.csv") if moorings else {}
    small = len(moorings) + len(calibrations) > MAX_SECTIONS
    sections, missing = [], dict[str, None]()
    deployments, coefficients = (words.cells("mooring", part) for part in ("deployments", "coefficients"))
    used = {name: site for name, site in moorings.items() if name not in stopped["moorings"]}
    for name, site in used.items():  # one by one, as the record of each is read into memory
        results = read_mooring(name, root, rows[name])
        sections.append(mooring_section(results, root, small=small))
        deployments += words.cells("mooring", "deployment", r=results, site=site)
        coefficients += words.cells("mooring", "coefficient_rows", r=results)
        missing |= dict.fromkeys(results.headings["missing"])
    others = [calibration_section(read_calibration(name, root), root, small=small) for name in calibrations]
    shared = [compass_section(name, root, small=small) for name in compasses]
    headers = {part: words.cells(part, "overview")[0] for part in ("mooring", "calibration", "compass")}
    for part, entries in (("mooring", sections), ("calibration", others)):
        reasons = stopped[f"{part}s"].items()
        entries[:0] = [stopped_section(part, name, why, headers[part]) for name, why in reasons]
    together = collect_figures(root, root, ["cruise"], small=False)
    return Report(
        title=title("Compass deviations corrected", attributes.get("project")),
        attributes=tuple((words.plain(name), str(value)) for name, value in attributes.items()),
        moorings=Overview(MOORINGS, headers["mooring"], sections),
        calibrations=Overview(CALIBRATIONS, headers["calibration"], others),
        compasses=Overview(COMPASSES, headers["compass"], shared),
        software=provenance.software(),
        date=provenance.date_created(),
        figures=tuple(together.values()) if moorings else (),
        small=small,
        tables=tuple(
            ReportTable(caption, rows[0], tuple(rows[1:]))
            for caption, rows in ((DEPLOYMENTS, deployments), (COEFFICIENTS, coefficients))
            if rows[1:]
        ),
        concealed=tuple(name for name in moorings if (root.parent / f"concealed/{name}.json").exists()),
        notes=tuple((row.title, row.note) for row in (*MOORING, *SECTIONS, *CRUISE) if row.note and moorings),
        missing=tuple(missing),
    )


def title(of_page: str, project: object) -> str:
    """Compose the title of a page, with the project if there is one."""
    return f"{of_page}: {project}" if project else of_page


def write(path: str | Path, report: Report) -> None:
    """Write the page; the same results give the same bytes."""
    write_page(path, "report.html", report=report, terms=words.Links())


def write_page(
    path: str | Path, template: str, *, styles: Sequence[str] = (STYLE,), scripts: Sequence[str] = (), **given: Any
) -> None:
    """Render an HTML template with its style sheets and scripts inline, which alone the page's policy admits."""
    texts = {kind: [(REPORT / name).read_text(encoding="utf-8") for name in names]
             for kind, names in (("style", styles), ("script", scripts))}  # fmt: skip
    texts["style"] = ["\n".join(texts["style"])]
    policy = ["default-src 'none'", "img-src data:", "base-uri 'none'", "form-action 'none'"]
    for kind, each in texts.items():
        known = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in each]
        policy += [" ".join([f"{kind}-src", *(f"'sha256-{one}'" for one in known)])] * bool(known)
    page = {"style": texts["style"][0], "scripts": texts["script"], "policy": "; ".join(policy)}
    text = words.environment(autoescape=True).get_template(template).render(**given, page=page)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def log_line(path: str | Path, report: Report) -> str:
    """Format the line about the page in the log."""
    size = Path(path).stat().st_size / 1e6
    missing = f"; attributes not given: {', '.join(report.missing)}" if report.missing else ""
    return f"{path}: {report.counts()} {size:.1f} MB{missing}".replace(words.SPACE, " ")
