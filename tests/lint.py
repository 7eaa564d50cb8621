"""snakemake --lint on the repository's own Snakefile, seen from a small cruise; exit status 1 where it has a remark."""

import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent

with tempfile.TemporaryDirectory() as folder:
    (Path(folder) / "config").mkdir()
    (Path(folder) / "config/config.yaml").write_text("moorings: []\n")
    command = [sys.executable, "-m", "snakemake", "--snakefile", PROJECT / "Snakefile", "--directory", folder, "--lint"]
    sys.exit(subprocess.run(command, check=False).returncode)
