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
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from compasslib.archive import provenance
from compasslib.archive.files import atomic_write
from compasslib.archive.summary import STOPPED
from compasslib.inference.wording import VERDICTS
from compasslib.plots.figures import MOORING, SECTIONS
from compasslib.report import words
from compasslib.report.sections import (
    Overview,
    ReportFigure,
    ReportSection,
    ReportTable,
    calibration_section,
    collect_figures,
    compass_section,
    embed,
    mooring_section,
    read_calibration,
    read_mooring,
    read_summary,
    stopped_section,
)

MAX_SECTIONS = 50  # above which figures are not embedded; a thousand moorings would need 400 MB
REPORT, STYLE = Path(__file__).resolve().parent, "templates/style.css"
NONE_STOPPED: Mapping[str, Mapping[str, str]] = {"moorings": {}, "calibrations": {}}


@dataclass(frozen=True)
class Report:
    """Content of the page."""

    title: str
    attributes: tuple[tuple[str, str], ...]
    moorings: Overview
    calibrations: Overview
    compasses: Overview
    software: str
    date: str
    figures: tuple[ReportFigure, ...] = ()  # figures of all moorings together
    concealed: tuple[str, ...] = ()  # moorings whose errors the processing was not told
    tables: tuple[ReportTable, ...] = ()  # deployments, and coefficients of the compasses
    notes: tuple[tuple[str, str], ...] = ()  # how the figures of moorings are read, by title
    missing: tuple[str, ...] = ()  # global attributes that the YAML files do not give for some mooring

    def counts(self) -> str:
        """Count moorings by verdict, calibrations and shared compasses."""
        verdicts = Counter(section.verdict for section in self.moorings.sections)
        known = ", ".join(f"{verdicts[each]} {each}" for each in (*VERDICTS, STOPPED) if verdicts[each])
        numbers = [f"{words.plural(verdicts.total(), 'mooring')} ({known})"] if known else []
        for part, noun in ((self.calibrations, "calibration"), (self.compasses, "shared compass")):
            many = "shared compasses" if noun == "shared compass" else None
            numbers += [words.plural(len(part.sections), noun, many)] if part.sections else []
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

    def with_figures(section: ReportSection) -> ReportSection:
        return section if small else replace(section, figures=embed(section.figures, root))

    titles = {part: words.cells(part, "overview") for part in ("mooring", "calibration", "compass")}  # caption, header
    sections, others = (
        [stopped_section(part, name, why, titles[part][1]) for name, why in stopped[f"{part}s"].items()]
        for part in ("mooring", "calibration")
    )
    missing, tables = dict[str, None](), {part: words.cells("mooring", part) for part in ("deployment", "coefficient")}
    for name in (name for name in moorings if name not in stopped["moorings"]):  # the record of each is in memory
        results = read_mooring(name, root, rows[name])
        sections.append(with_figures(mooring_section(results, root)))
        for part, lines in tables.items():
            lines += words.cells("mooring", f"{part}_rows", r=results, site=moorings[name])
        missing |= dict.fromkeys(results.headings["missing"])
    others += [with_figures(calibration_section(read_calibration(name, root), root)) for name in calibrations]
    shared = [with_figures(compass_section(name, root)) for name in compasses]
    together = embed(collect_figures(root, root, ["cruise"]).values(), root) if moorings else ()
    return Report(
        title=title("Compass deviations corrected", attributes.get("project")),
        attributes=tuple((words.plain(name), str(value)) for name, value in attributes.items()),
        moorings=Overview(titles["mooring"][0][0], titles["mooring"][1], sections),
        calibrations=Overview(titles["calibration"][0][0], titles["calibration"][1], others),
        compasses=Overview(titles["compass"][0][0], titles["compass"][1], shared),
        software=provenance.software(),
        date=provenance.date_created(),
        figures=together,
        tables=tuple(ReportTable(title[0], header, tuple(rows)) for title, header, *rows in tables.values() if rows),
        concealed=tuple(name for name in moorings if (root.parent / f"concealed/{name}.json").exists()),
        notes=tuple((row.title, row.note) for row in (*MOORING, *SECTIONS) if row.note and moorings),
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
    return f"{path}: {report.counts()} {Path(path).stat().st_size / 1e6:.1f} MB".replace(words.SPACE, " ")
