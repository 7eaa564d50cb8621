"""Records of one compass: each is judged alone, all are joined, and each is judged again with what the others tell."""


rule diagnose_alone:
    """As diagnose, of a record whose compass has others: what it shows alone, and what they may learn from it."""
    input:
        record=MOORINGS.compromised,
        references=MOORINGS.reference,
        pairs="results/{mooring}/overlap.nc",
        wide="results/{mooring}/wide/overlap.nc",
        fit="results/{mooring}/work/fit.json",
        field="results/{mooring}/work/field.json",
        observatory=MOORINGS.observatory,
    output:
        diagnosis="results/{mooring}/work/alone/diagnosis.json",
        deviation="results/{mooring}/work/alone/deviation.json",
        assessment="results/{mooring}/work/alone/assessment.json",
        summary="results/{mooring}/work/alone/summary.json",
    params:
        options=MOORINGS.diagnose,
        code=MOORINGS.code("diagnose.py"),
    wildcard_constraints:
        mooring=plan.only(COMPASSES.moorings),
    log:
        "results/{mooring}/logs/diagnose_alone.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose_alone.tsv"
    script:
        "../scripts/diagnose.py"


rule join:
    """What all records of one compass tell -> its iron and effects, who does not belong, what each may learn."""
    input:
        summaries=COMPASSES.summaries,
        calibrations=COMPASSES.calibrations,
    output:
        joined="results/compasses/{compass}/compass.json",
        diagnosis="results/compasses/{compass}/diagnosis.json",
    params:
        spheres=COMPASSES.spheres,
        min_effect_deg=CRUISE.options.diagnose.min_effect_deg,
        code=MOORINGS.code("join.py"),
    log:
        "results/compasses/{compass}/logs/join.log",
    benchmark:
        "results/compasses/{compass}/benchmarks/join.tsv"
    script:
        "../scripts/join.py"


rule share:
    """As diagnose, with what the other records of the compass tell beforehand."""
    input:
        joined=COMPASSES.joined,
        alone=multiext("results/{mooring}/work/alone/", "diagnosis.json", "deviation.json", "assessment.json"),
        record=MOORINGS.compromised,
        references=MOORINGS.reference,
        pairs="results/{mooring}/overlap.nc",
        wide="results/{mooring}/wide/overlap.nc",
        fit="results/{mooring}/work/fit.json",
        field="results/{mooring}/work/field.json",
        observatory=MOORINGS.observatory,
    output:
        diagnosis="results/{mooring}/diagnosis.json",
        deviation="results/{mooring}/deviation.json",
        assessment="results/{mooring}/assessment.json",
    params:
        options=MOORINGS.diagnose,
        tilt=MOORINGS.tilt,
        code=MOORINGS.code("share.py"),
    wildcard_constraints:
        mooring=plan.only(COMPASSES.moorings),
    log:
        "results/{mooring}/logs/diagnose.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose.tsv"
    script:
        "../scripts/share.py"


rule joined_figures:
    """A compass -> the iron that each record shows, and the curve that they share."""
    input:
        joined="results/compasses/{compass}/compass.json",
    output:
        figures=[
            report(
                f"results/compasses/{{compass}}/figures/{figure}.png",
                caption="../report/compass.rst",
                category="Compasses",
                subcategory="{compass}",
                labels={"figure": figure},
            )
            for figure in COMPASSES.figures
        ],
    params:
        code=MOORINGS.code("joined_figures.py"),
    log:
        "results/compasses/{compass}/logs/figures.log",
    benchmark:
        "results/compasses/{compass}/benchmarks/figures.tsv"
    script:
        "../scripts/joined_figures.py"
