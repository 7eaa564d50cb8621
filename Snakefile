"""From raw exports to a corrected archive; the workflow itself stands in workflow/."""


include: "workflow/Snakefile"


rule default:
    """What the included file makes: Snakemake takes no target from there by itself."""
    input:
        rules.all.input,
    default_target: True
