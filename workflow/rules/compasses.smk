"""Records of one compass: each is judged alone, all are joined, and each is judged again with what the others tell."""


rule join:
    """What all records of one compass tell -> its iron and effects, who does not belong, what each may learn."""
    input:
        PLAN.inputs("join"),
    output:
        update("results/compasses/{compass}/logs/join.json"),
    log:
        "results/compasses/{compass}/logs/join.log",
    params:
        **PLAN.params("join"),
    script:
        "../scripts/join.py"


rule joined_figures:
    """A compass -> the iron that each record shows, and the curve that they share."""
    input:
        PLAN.inputs("joined_figures"),
    output:
        update("results/compasses/{compass}/logs/figures.json"),
    log:
        "results/compasses/{compass}/logs/figures.log",
    params:
        **PLAN.params("joined_figures"),
    script:
        "../scripts/joined_figures.py"
