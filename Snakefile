"""From raw exports to a corrected archive; the workflow itself stands in workflow/."""


include: "workflow/Snakefile"
