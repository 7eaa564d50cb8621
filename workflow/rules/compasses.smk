"""Records that share a compass: each is diagnosed alone, all are joined, and each is diagnosed given the others."""


rule join:
    """Join the records of a compass: its iron and effects, rejected records, and the prior for each record."""
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
    """Draw the iron by each record of a compass, and the deviation curve that they share."""
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
