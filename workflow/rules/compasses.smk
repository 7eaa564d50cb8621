"""Records of one compass: each is judged alone, all are joined, and each is judged again with what the others tell."""


rule diagnose_alone:
    """As diagnose, of a record whose compass has others: what it shows alone, and what they may learn from it."""
    input:
        PLAN.inputs("diagnose_alone"),
    output:
        "results/{mooring}/logs/diagnose_alone.json",
    log:
        "results/{mooring}/logs/diagnose_alone.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose_alone.tsv"
    wildcard_constraints:
        mooring=PLAN.names("diagnose_alone"),
    params:
        **PLAN.params("diagnose_alone"),
    script:
        "../scripts/diagnose.py"


rule join:
    """What all records of one compass tell -> its iron and effects, who does not belong, what each may learn."""
    input:
        PLAN.inputs("join"),
    output:
        "results/compasses/{compass}/logs/join.json",
    log:
        "results/compasses/{compass}/logs/join.log",
    benchmark:
        "results/compasses/{compass}/benchmarks/join.tsv"
    params:
        **PLAN.params("join"),
    script:
        "../scripts/join.py"


rule share:
    """As diagnose, with what the other records of the compass tell beforehand."""
    input:
        PLAN.inputs("share"),
    output:
        "results/{mooring}/logs/diagnose.json",
    log:
        "results/{mooring}/logs/diagnose.log",
    benchmark:
        "results/{mooring}/benchmarks/diagnose.tsv"
    wildcard_constraints:
        mooring=PLAN.names("share"),
    params:
        **PLAN.params("share"),
    script:
        "../scripts/share.py"


rule joined_figures:
    """A compass -> the iron that each record shows, and the curve that they share."""
    input:
        PLAN.inputs("joined_figures"),
    output:
        "results/compasses/{compass}/logs/figures.json",
    log:
        "results/compasses/{compass}/logs/figures.log",
    benchmark:
        "results/compasses/{compass}/benchmarks/figures.tsv"
    params:
        **PLAN.params("joined_figures"),
    script:
        "../scripts/joined_figures.py"
