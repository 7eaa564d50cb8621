"""All methods, tables and numbers of the three papers: where they are implemented and tested, and numbers compared.

    python benchmarks/papers.py > docs/background/papers.md      writes the page

A row with a printed number computes ours here. If the two differ, or a method is not implemented, the row says why.
"""

# ruff: noqa: E501, RUF100 - texts of a row are not wrapped

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.calibrations import bench, budget
from compasslib.calibrations.swing import adjustment
from compasslib.deviation.model import MIN_HORIZONTAL_NT
from compasslib.deviation.series import series_deviation, series_folds

MISPRINT = "misprint"

# --- the published readings -----------------------------------------------------------------------------------------

DELTA = dict(zip(adjustment.POINTS, (-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123), strict=True))
PSI = dict(zip(adjustment.POINTS, (-1.312, 2.888, -7.512, -3.414, 2.485, 15.586, 4.489, 14.988), strict=True))
COURSES, DECLINATION = (0, 46, 91, 136, 179, 226, 269, 315), -0.135
BY_DELTA, BY_PSI = (adjustment.principal_coefficients(*x) for x in ((DELTA, 0.0), (PSI, DECLINATION)))
ROWS_OF = {kind: budget.sources({}, budget.LE_MENN, kind) for kind in (budget.PLATFORM, budget.TILT)}


def letters(content: dict[str, float], names: str) -> str:
    """Format coefficients to four decimals, without zeros at their end."""
    return ", ".join(f"{name} {round(float(content[name]), 4):g}" for name in names.split())


def quadrants(content: dict[str, dict[str, float]]) -> str:
    return ", ".join(f"{value:.3f}" for value in content["D_from"].values())


def pseudo() -> str:
    """Compute the pseudo-deviations of MM Table 2 from courses and deviations."""
    recorded = angles.wrap360(45.0 * np.arange(8) - DECLINATION - np.array(list(DELTA.values())))
    return ", ".join(f"{x:.3f}" for x in adjustment.pseudo_deviations(COURSES, recorded).values())


def with_residual(degrees: float) -> str:
    rows = (*ROWS_OF[budget.PLATFORM], budget.Source(budget.FIT_RESIDUAL, degrees, ""))
    return f"{budget.expanded(rows):.2f}"


@dataclass(frozen=True)
class Row:
    """One method, table or number of a paper."""

    place: str  # equation, table, figure or section
    what: str
    code: str = ""  # module[:name] of compasslib, or a path; empty if it is not implemented
    test: str = ""  # file::test below tests/
    printed: str = ""
    ours: str = ""
    why: str = ""  # reason of a difference, or why it is not implemented


LE_MENN = [
    Row("(1), (2)", "ellipsoid of hard and soft iron from three axes; the noise term of (2) has the sign −2",
        "calibrations.magnetometer.ellipsoid", "test_calibrations_magnetometer.py::test_hmc5883l_needs_the_whole_ellipsoid"),
    Row("(3)", "one cycle", "calibrations.curves:ONE_CYCLE",
        "test_calibrations_curves.py::test_four_headings_determine_only_one_cycle"),
    Row("(4)", "exact compass; the printed sine in the denominator is a cosine, the argument the correct heading",
        "compass:recorded_heading", "test_compass.py::test_le_menn_4_with_atan2_is_the_same_compass"),
    Row("(5), (6)", "Smith's five terms in the recorded heading, D and E exchanged against von Appen",
        "calibrations.curves:SMITH", "test_calibrations_curves.py::test_le_menn_5_exchanges_the_letters_d_and_e"),
    Row("(7)", "polynomial of degree 6, which jumps at north", "calibrations.curves:POLYNOMIAL",
        "test_calibrations_curves.py::test_the_polynomial_is_that_of_le_menn_7_and_jumps_at_north"),
    Row("section 2, Table 4", "expanded uncertainty of reference directions, degrees", "calibrations.budget:ROWS",
        "test_calibrations_platform.py::test_budget_of_le_menn_reproduces_the_published_numbers",
        "0.90", f"{budget.expanded(ROWS_OF[budget.PLATFORM]):.2f}"),
    Row("section 2", "60 to 75 nT across 22,000 nT as angles (the paper: 0.13 % of a turn, 0.45°), degrees",
        "calibrations.budget:physical_field",
        "test_calibrations_platform.py::test_budget_of_le_menn_reproduces_the_published_numbers", "0.45",
        " to ".join(f"{x:.2f}" for x in budget.physical_field(ROWS_OF[budget.PLATFORM])["field_deg"]),
        "the paper turns a share of the field into a share of a turn; both are given"),
    Row("section 2", "triangular distribution of a maker's accuracy, the divisor", "calibrations.budget:TRIANGULAR",
        "test_calibrations_platform.py::test_given_budget_rows_override_the_published_ones",
        "√6", f"√{budget.TRIANGULAR[0] ** 2:.0f}"),
    Row("section 2, Table 5", "expanded uncertainty of reference tilts, degrees; calibration of a tilt sensor",
        "calibrations.tilt", "test_calibrations_tilt.py::test_both_axes_are_recovered_for_any_sign_of_the_reference",
        "0.40", f"{budget.expanded(ROWS_OF[budget.TILT]):.2f}", "the table is a picture; the numbers of the text make 0.38"),
    Row("section 2, Table 3", "homogeneity of the field from an instrument spun in four directions",
        "calibrations.bench:measure_homogeneity",
        "test_calibrations_platform.py::test_observatory_corrects_the_field_and_spinning_gives_homogeneity"),
    Row("section 2", "a record of the field during the calibration", "calibrations.bench:correct_field",
        "test_calibrations_platform.py::test_observatory_corrects_the_field_and_spinning_gives_homogeneity"),
    Row("Fig. 5", "magnetic map of the site", why="a survey, no calibration"),
    Row("section 3, Figs 6 to 19", "largest error and error from peak to peak", "calibrations.platform:calibrate_readings",
        "test_calibrations_platform.py::test_each_form_states_expanded_uncertainty_and_residual_errors"),
    Row("Fig. 7", "shift of the phase where a battery pack is turned", "calibrations.result:compare",
        "test_calibrations_platform.py::test_a_pack_turned_by_ninety_degrees_moves_the_phase_by_ninety"),
    Row("Figs 7, 10, 12, 13", "several calibrations on one figure, the shift of each against the first",
        "plots.calibrations:draw_compared",
        "test_calibrations_platform.py::test_compared_calibrations_show_phase_shifts_from_the_first"),
    Row("Figs 8 to 10", "before and after within the uncertainty", "calibrations.result:compare",
        "test_calibrations_platform.py::test_rate_of_false_differences_matches_the_significance_level"),
    Row("Table 6", "magnetic induction of battery packs", why="readings of another instrument"),
    Row("sections 3 to 5, 7", "what stood in place: battery, cage, frame", "calibrations.at_mooring:other_parts",
        "test_calibrations_platform.py::test_parts_that_differ_from_the_calibration_give_a_warning"),
    Row("section 4", "an object at several distances", "calibrations.bench",
        "test_calibrations_platform.py::test_object_is_compared_with_the_bench_without_it"),
    Row("section 7", "power by which an object's influence falls with distance", "calibrations.bench:DIPOLE",
        "test_calibrations_platform.py::test_exponent_and_safe_distance_intervals_cover_the_truth",
        "2", f"{bench.DIPOLE:.0f}", "a dipole's field falls as the cube of the distance"),
    Row("section 5", "a lowered profiler and its rosette", "calibrations.two_heads",
        "test_calibrations_two_heads.py::test_a_turning_cast_gives_offset_coefficients_and_clock"),
    Row("Fig. 17", "expanded uncertainty by Smith's terms, with the residual that it implies (0.35°), degrees",
        "calibrations.budget:expanded", "test_calibrations_platform.py::test_budget_of_le_menn_reproduces_the_published_numbers",
        "1.14", with_residual(0.35)),
    Row("section 6", "the same by the polynomial (0.70°), degrees", "calibrations.budget:expanded",
        "test_calibrations_platform.py::test_budget_of_le_menn_reproduces_the_published_numbers",
        "1.66", with_residual(0.70)),
    Row("section 6", "expanded uncertainty of each form of the curve", "calibrations.platform",
        "test_calibrations_platform.py::test_each_form_states_expanded_uncertainty_and_residual_errors"),
    Row("Fig. 18", "a constant shift after a maker's own calibration", "calibrations.platform",
        "test_calibrations_curves.py::test_constant_shift_is_reported_with_its_uncertainty"),
    Row("section 7", "no correction below this horizontal field, nT", "deviation.model:weak_field_warnings",
        "test_deviation_transfer.py::test_a_mooring_in_a_weak_field_is_warned_of_at_sea_too", "5000", f"{MIN_HORIZONTAL_NT:.0f}"),
]  # fmt: skip

MONCUNILL = [
    Row("(1) to (5)", "series in the compass course", "deviation.series:series_design",
        "test_calibrations_swing_cardinal.py::test_coefficients_from_deviations"),
    Row("(6) to (9), (16), (17)", "adjustment: nullify on two cardinal courses, halve on their opposites",
        "calibrations.swing.adjustment:adjust",
        "test_calibrations_swing_cardinal.py::test_adjustment_leaves_only_the_effect_of_the_drift"),
    Row("(10) to (15)", "A, B, C and E from four deviations", "calibrations.swing.adjustment:principal_coefficients",
        "test_calibrations_swing_cardinal.py::test_coefficients_from_deviations"),
    Row("(18) to (21), (46)", "D from a quadrantal deviation, and its mean",
        "calibrations.swing.adjustment:principal_coefficients",
        "test_calibrations_swing_cardinal.py::test_coefficients_from_deviations"),
    Row("(22)", "pseudo-deviation with the water", "calibrations.swing.adjustment:set_and_drift_terms",
        "test_calibrations_swing_cardinal.py::test_set_and_drift_by_the_triangle_of_speeds"),
    Row("(23) to (34)", "adjustment by courses over ground", "calibrations.swing.adjustment:adjust",
        "test_calibrations_swing_cardinal.py::test_adjustment_leaves_only_the_effect_of_the_drift"),
    Row("(35), (36), (38) to (45)", "A, D and E from pseudo-deviations", "calibrations.swing.adjustment:principal_coefficients",
        "test_calibrations_swing_cardinal.py::test_coefficients_from_pseudo_deviations"),
    Row("(37), (43), Table 1", "largest error of D and E at S/d = 7, degrees", "calibrations.swing.adjustment:error_bound_deg",
        "test_calibrations_swing_cardinal.py::test_error_bound", "0.585", f"{float(adjustment.error_bound_deg(1 / 7)):.3f}"),
    Row("section 5.3", "coefficients from deviations, degrees", "calibrations.swing.adjustment:principal_coefficients",
        "test_calibrations_swing_cardinal.py::test_coefficients_from_deviations",
        "A -0.0775, B_bar -7.0005, C_bar -2.3985, E 1.299, D 1.475", letters(BY_DELTA, "A B_bar C_bar E D")),
    Row("Table 2", "pseudo-deviations from N to NW, degrees", "calibrations.swing.adjustment:pseudo_deviations",
        "test_calibrations_swing_cardinal.py::test_pseudo_deviations_of_table_2",
        ", ".join(f"{x:.3f}" for x in PSI.values()), pseudo()),
    Row("section 5.4", "coefficients from pseudo-deviations, degrees", "calibrations.swing.adjustment:principal_coefficients",
        "test_calibrations_swing_cardinal.py::test_coefficients_from_pseudo_deviations",
        "A_bar -0.4625, A -0.3275, B_bar -6.0005, C_bar -1.8985, D 1.725, E 1.049",
        letters(BY_PSI, "A_bar A B_bar C_bar D E")),
    Row("Table 3", "A, D and E by courses minus those by headings, degrees", "calibrations.swing",
        "test_calibrations_swing.py::test_true_heading_is_preferred_over_the_course", "-0.25, 0.25, -0.25",
        ", ".join(f"{BY_PSI[k] - BY_DELTA[k]:.2f}" for k in "ADE")),
    Row("Table 4", "D by quadrant from deviations, degrees", "calibrations.swing.adjustment:principal_coefficients",
        "test_calibrations_swing_cardinal.py::test_coefficients_from_deviations", "8.746, 0.948, 8.153, -11.947",
        quadrants(BY_DELTA)),
    Row("Table 4, (44), (47) to (50)", "the same from pseudo-deviations; (48) and (49) miss bars, degrees",
        "calibrations.swing.adjustment:principal_coefficients",
        "test_calibrations_swing_cardinal.py::test_coefficients_from_pseudo_deviations", "8.935, 0.051, 10.464, -12.550",
        quadrants(BY_PSI)),
    Row("section 6", "residual B and C by two headings", "calibrations.swing.adjustment:residual_from_two_headings",
        "test_calibrations_swing_cardinal.py::test_two_headings_give_b_and_c"),
    Row("(51), (52)", "the sun's azimuth; in (52) a longitude east is added", "calibrations.swing:azimuth",
        "test_calibrations_swing_cardinal.py::test_sun_by_the_almanac_of_the_solar_position_algorithm"),
    Row("(53)", "directive force by heading", "calibrations.swing.adjustment:directive_force",
        "test_calibrations_swing_cardinal.py::test_the_directive_force_is_that_of_the_exact_compass_at_first_order"),
    Row("(54) to (60)", "residual B and C by one mark (Lushnikov)", "calibrations.swing.adjustment:residual_by_lushnikov",
        "test_calibrations_swing_cardinal.py::test_one_heading_determines_the_component_across_it"),
    Row("(60)", "what the drift leaves there at S/d = 7, degrees", "calibrations.swing.adjustment:drift_in_one_heading",
        "test_calibrations_swing.py::test_five_courses_and_one_mark_state_the_error_by_drift", "nothing",
        f"up to {adjustment.drift_in_one_heading(1 / 7, 40.0)['largest_deg']:.1f}", "the paper does not mention it"),
    Row("section 7", "complete method: five courses and one mark", "calibrations.swing.model:fit_swing",
        "test_calibrations_swing.py::test_five_courses_and_one_mark_state_the_error_by_drift"),
    Row("section 7.1, points 2 and 4", "mark and quadrantal course in one quadrant", "calibrations.swing",
        "test_calibrations_swing.py::test_five_courses_and_one_mark_state_the_error_by_drift"),
    Row("section 7.1, points 5 and 6", "table every 10 or 15°; limit of 4° (ISO 25862)", "calibrations.swing.adjustment:verdict",
        "test_calibrations_swing_cardinal.py::test_verdict", "4", f"{adjustment.LIMIT_DEG:g}"),
    Row("section 7.2", "nullifying B or C; which of them", "calibrations.swing.adjustment:plan_magnets",
        "test_calibrations_swing_cardinal.py::test_nullifying"),
    Row("section 7.3", "least speed, knots", "calibrations.swing.adjustment:verdict",
        "test_calibrations_swing_cardinal.py::test_verdict", "7", f"{adjustment.MIN_SPEED_KN:g}"),
    Row("section 2.2", "soft-iron correctors of D and E (the paper leaves them out)", "calibrations.swing.adjustment:spheres",
        "test_calibrations_swing_cardinal.py::test_spheres_and_magnets_nullify_their_terms"),
    Row("(handbook)", "Flinders bar: induced and hard iron by two dips", "deviation.model:separate_iron",
        "test_deviation_transfer.py::test_two_places_separate_hard_and_induced_iron"),
    Row("Fig. 9", "courses that are late while the ship turns are applied; what the certificate states without and with it",
        "calibrations.swing.observations:read",
        "test_calibrations_swing.py::test_a_delay_that_explains_most_of_the_misfit_is_applied"),
    Row("(22), Fig. 9", "one set and drift: that of the fit, in the diagnosis too", "inference.kinds.swing:diagnose",
        "test_inference_swing.py::test_speeds_that_vary_show_the_water"),
]  # fmt: skip

B_OF_FIG_5 = (0.0, 20.0, 45.0, 57.3, 90.0, 135.0)
VON_APPEN = [
    Row("(1)", "series in the correct heading", "deviation.series:fit_series",
        "test_deviation_von_appen.py::test_fit_recovers_a_curve_without_noise"),
    Row("(2), (3)", "correct heading and deviation of a pair", "deviation.model:observed_heading",
        "test_deviation_von_appen.py::test_fit_recovers_a_curve_without_noise"),
    Row("(4)", "corrected direction", "deviation.correction:correct_in_pieces",
        "test_deviation_correction.py::test_corrected_velocity_is_the_recorded_one_turned_by_deviation_and_declination"),
    Row("section 3, Fig. 5", "recorded direction at a correct heading of 90°, by B, degrees", "deviation.series:series_deviation",
        "test_deviation_von_appen.py::test_figure_5_at_a_correct_heading_of_90", "90, 70, 45, 33.7, 0, -45",
        ", ".join(f"{90.0 - float(series_deviation((0.0, b, 0.0, 0.0, 0.0), 90.0)):g}" for b in B_OF_FIG_5),
        f"{MISPRINT}: 90 − 57.3 is 32.7"),
    Row("section 3", "largest B without a fold, degrees", "deviation.series:series_folds",
        "test_deviation_von_appen.py::test_series_folds_beyond_180_over_pi", "57.3",
        f"{next(b for b in np.arange(50.0, 70.0, 0.01) if series_folds((0.0, b, 0.0, 0.0, 0.0))):.1f}"),
    Row("section 4", "inversion around the least ∂γ/∂β, NaN elsewhere", "deviation.series:invert_series",
        "test_deviation_von_appen.py::test_folded_series_inverts_only_its_sluggish_stretch"),
    Row("section 4", "the same as an author would: about the mean deviation, inverted where most data lie",
        "deviation.series:fit_series_about_mean",
        "test_deviation_von_appen.py::test_the_branch_with_most_headings_can_be_inverted"),
    Row("section 4", "EG4: inverted over 29° to 84°, 185° of correct headings; 13 % not corrected",
        why="its data are not in the repository; EG4 of the demonstration has iron of the same strength"),
    Row("section 2, Table 1", "seven moorings, their instruments and ranges", "demo.demonstration",
        "test_simulation.py::test_configuration_matches_the_simulation"),
    Row("section 2", "blow-down and tilts of 3 to 10°", "demo.water",
        "test_simulation.py::test_sphere_tilts_as_published"),
    Row("section 2, appendix", "pairs: two bins each, 20 min, 20 m", "preparation.pairs",
        "test_preparation_overlap.py::test_pairs_are_less_than_20_minutes_and_20_metres_apart"),
    Row("appendix", "one hourly grid, ±30 min", "preparation.gridding",
        "test_preparation_overlap.py::test_interpolation_is_linear_nearest_or_nan_by_gap"),
    Row("appendix", "`compass_correction.m` on ready-made pairs (`example_vels.mat`)", "preparation.pairs",
        "test_deviation_given.py::test_ready_made_pairs_of_tables_and_matlab_files_are_the_same"),
    Row("Figs 6, 7", "deviation with scatter, β → γ, γ → β", "plots.deviation", "test_plots.py::test_figure_is_whole_and_legible"),
    Row("Figs 8, 9", "histograms of headings and directions, scatter of directions", "plots.deviation",
        "test_plots.py::test_scatter_titles_state_count_mean_and_rms"),
    Row("Fig. 2", "the array, drawn from configuration (`results/figures/array.png`)", "plots.moorings:draw_array",
        "test_plots.py::test_array_figure_names_moorings_only_if_few"),
    Row("Figs 4, 5", "definition of angles; synthetic curves, as figures", "plots.moorings:draw_synthetic_curves",
        "test_plots.py::test_synthetic_curves_and_angles_match_the_published_figures"),
    Row("introduction", "calibration before and after a deployment", "calibrations.at_mooring:carry_to_mooring",
        "test_calibrations_platform.py::test_change_between_two_calibrations_enters_the_uncertainty"),
    Row("introduction", "a calibration at another latitude", "deviation.model:transfer_coefficients",
        "test_deviation_transfer.py::test_without_knowledge_of_the_iron_the_extremes_enclose_the_truth"),
    Row("introduction", "a lowered profiler beside a ship's: a how-to on made data", "docs/howto/lowered.md",
        "test_example_lowered.py::test_heading_errors_match_the_stated_uncertainty"),
    Row("footnote 1", "wrong tables in an instrument's firmware: an empirical form of a bench's curve", "calibrations.curves:EMPIRICAL",
        "test_calibrations_curves.py::test_wrong_firmware_table_is_fitted_by_the_empirical_curve"),
    Row("section 5", "distance from the iron", "deviation.model:estimate_safe_distance",
        "test_deviation_tables.py::test_deviation_falls_with_the_cube_of_distance_within_bounds"),
]  # fmt: skip

PAPERS = {
    "Le Menn et al. 2023": LE_MENN,
    "Moncunill Marimón et al. 2023": MONCUNILL,
    "von Appen 2015": VON_APPEN,
}

HEAD = """# The three papers, row by row

Made by `python benchmarks/papers.py`; a test fails where page and code differ. *Printed* is what the paper prints, *ours* what this
software computes from the same numbers when the page is made. Paths are below `compasslib/` and `tests/`.
"""


PICTURES = """![Angles](../angles.png)

*Von Appen 2015, Fig. 4: α of the current and β of magnetic north from beam 3, γ as the needle has it, δ of magnetic from true north.*

![Synthetic curves](../synthetic.png)

*Von Appen 2015, Fig. 5: deviation, recorded heading and lookup table of series with B alone.*
"""


def page() -> str:
    """Format all rows as Markdown, a table for each paper."""
    parts = [HEAD]
    for paper, rows in PAPERS.items():
        done = sum(bool(row.code) for row in rows)
        parts.append(f"## {paper}\n\n{done} of {len(rows)} rows are in the software.\n")
        parts.append("| place | what | where | held by | printed | ours |\n|---|---|---|---|---|---|")
        parts += [_line(row) for row in rows]
        parts.append("")
    return "\n".join([*parts, PICTURES])


def _line(row: Row) -> str:
    where = f"`{row.code}`" if row.code else "–"
    what = f"{row.what} ({row.why})" if row.why else row.what
    test = f"`{row.test}`" if row.test else "–"
    return f"| {row.place} | {what} | {where} | {test} | {row.printed or '–'} | {row.ours or '–'} |"


if __name__ == "__main__":
    print(page(), end="")
