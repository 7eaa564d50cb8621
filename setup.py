"""Puts the workflow into the wheel, with license, lock and glossary that it reads; the rest is in pyproject.toml."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

RELEASE_FILES = ("LICENSE", "requirements/run.txt", "docs/glossary.md")


class BuildWithWorkflow(build_py):
    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            into = Path(self.build_lib) / "compasslib/workflow"
            shutil.rmtree(into, ignore_errors=True)
            shutil.copytree("workflow", into, ignore=shutil.ignore_patterns("__pycache__", ".snakemake*"))
            for name in RELEASE_FILES:
                (into / name).parent.mkdir(exist_ok=True)
                shutil.copy(name, into / name)


setup(cmdclass={"build_py": BuildWithWorkflow})
