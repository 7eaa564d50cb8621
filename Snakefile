"""From raw exports to a corrected archive; the workflow itself stands in workflow/."""


include: "workflow/Snakefile"


# Snakemake takes no target from the included file by itself.
rule default:
    default_target: True
    input:
        rules.all.input,
