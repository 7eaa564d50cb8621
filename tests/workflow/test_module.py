"""Would catch a workflow that cannot be used as a module from Git, as docs/howto/install.md says, with a wheel."""

import io
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from textwrap import dedent

import pytest

from compasslib import __version__
from compasslib.archive import deposit
from tests.world.launch import PROJECT, copied_project, environment, jobs_in
from tests.world.sea import cruise

OTHER = "1.0.0"  # a version of the rules that another library belongs to
EXTENDED = """ as compass_*

rule rows:
    default_target: True
    input: rules.compass_summary.output.summary
    output: "rows.txt"
    shell: "wc -l < {input} > {output}"
"""


@pytest.fixture(scope="module")
def there(tmp_path_factory):
    """A repository of the rules in two versions, the wheel of a deposit, unpacked, and a cruise."""
    folder = tmp_path_factory.mktemp("module")
    repository = copied_project(folder / "repository", "workflow")
    rules = (repository / "workflow/Snakefile").read_text()
    who = {f"GIT_{role}_{key}": "a@b" for role in ("AUTHOR", "COMMITTER") for key in ("NAME", "EMAIL")}
    for version in (__version__, OTHER):
        text = rules.replace(f'VERSION = "{__version__}"', f'VERSION = "{version}"')
        (repository / "workflow/Snakefile").write_text(text)
        for command in ("init --quiet", "add .", "commit --quiet --message rules", f"tag v{version}"):
            subprocess.run(["git", "-C", repository, *command.split()], check=True, env=os.environ | who)
    zipfile.ZipFile(io.BytesIO(deposit.pack_wheel())).extractall(folder / "installed")
    copied_project(cruise(folder / "cruise", n=60), "workflow/profiles/default")
    options = "moorings: config/moorings\ndiagnose: {enabled: false}\n"
    (folder / "cruise/config/config.yaml").write_text(options)
    return folder


def use(there: Path, *options: str, more: str = "", tag: str = __version__) -> subprocess.CompletedProcess:
    """Run the Snakefile of the page, with the rules of a tag."""
    page = (PROJECT / "docs/howto/install.md").read_text()
    (text,) = re.findall(r"^    configfile:.*from compasslib$", page, re.MULTILINE | re.DOTALL)
    text = dedent(text).replace("/path/to/clone", "../repository").replace(f'tag="v{__version__}"', f'tag="v{tag}"')
    (there / "cruise/workflow/Snakefile").write_text(text + more)
    command, into = [sys.executable, "-m", "snakemake", "--cores", "2", *options], environment(there / "installed")
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=there / "cruise", env=into)


def test_rules_scripts_and_captions_come_from_git(there):
    """Renamed and extended; by their own names, as in Snakemake's catalogue, nothing that is made is made again."""
    ran = use(there, more=EXTENDED)
    assert ran.returncode == 0 and "rule compass_summary:" in ran.stderr, ran.stderr
    assert (there / "cruise/rows.txt").read_text().strip() == "2"
    assert "not present in the Snakefile" not in ran.stderr  # local rules, by their names here
    left = {"grid", "figures", "sections", "cruise_figures", "report", "provenance"}
    assert {rule for rule, _ in jobs_in(use(there, "--dry-run").stdout)} == left
    made = use(there, "--report", "page.html", "results/summary.csv")
    assert made.returncode == 0 and "One row per mooring." in (there / "cruise/page.html").read_text(), made.stderr


def test_rules_of_another_version_are_refused_in_one_line(there):
    ran = use(there, tag=OTHER)
    (line,) = [line for line in ran.stderr.splitlines() if "error" in line]
    assert ran.returncode == 1 and "Traceback" not in ran.stderr
    advice = f"install compasslib {OTHER}, or take the rules of {__version__}"
    assert line == f"error: compasslib: expected version {OTHER}, as the rules, found {__version__}; {advice}"
