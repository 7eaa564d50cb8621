"""A Slurm of one node on loopback, from Debian's packages, for a test."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

PROFILE = Path(__file__).resolve().parents[1] / "workflow/profiles/slurm"
# What a run on the loopback needs beside the profile: it keeps no accounts, so that the queue itself must be asked, and
# it may be asked often; one core a mooring, so that two cores have two.
OPTIONS = (
    *("--workflow-profile", str(PROFILE)),
    *("--slurm-status-command", "squeue"),
    *("--slurm-init-seconds-before-status-checks", "1"),
    *("--config", "mooring_cores=1"),
)
DAEMONS = ("munged", "slurmctld", "slurmd")
# Where every client looks: the plugin takes SLURM_CONF out of its jobs' environment.
CONFIGURATION = Path("/etc/slurm/slurm.conf")
NAME = "ClusterName=loopback"
SETTINGS = (
    f"{NAME}\n"
    + """\
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MinJobAge=3600
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory=4000 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES State=UP
"""
)


def missing() -> str:
    """Return why no Slurm can be started here, nothing where it can."""
    absent = [name for name in (*DAEMONS, "sbatch") if shutil.which(name) is None]
    if absent:
        return f"no {absent[0]}: apt-get install slurm-wlm munge"
    if find_spec("snakemake_executor_plugin_slurm") is None:
        return "no snakemake-executor-plugin-slurm: make slurm"
    if os.geteuid() != 0:
        return "the daemons are started as root"
    # One that an interrupted test left is written over.
    foreign = CONFIGURATION.exists() and NAME not in CONFIGURATION.read_text()
    return f"{CONFIGURATION} exists: this machine has a Slurm of its own" if foreign else ""


@contextmanager
def cluster(folder: Path) -> Iterator[None]:
    """Run a cluster of this machine alone while the block runs.

    Args:
        folder: for its state and logs.
    """
    (folder / "state").mkdir(parents=True)
    key = folder / "munge.key"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o400)
    CONFIGURATION.parent.mkdir(exist_ok=True)
    settings = SETTINGS.format(host=socket.gethostname(), folder=folder, cpus=os.cpu_count())
    CONFIGURATION.write_text(settings)
    socket_of = f"--socket={folder}/munge.socket"
    files = [f"--{kind}-file={folder}/munge.{kind}" for kind in ("pid", "log", "seed")]
    try:
        subprocess.run(["munged", "--force", f"--key-file={key}", socket_of, *files], check=True)
        subprocess.run(["slurmctld"], check=True)
        subprocess.run(["slurmd", "-N", socket.gethostname()], check=True)
        _wait()
        yield
    finally:
        for daemon in ("slurmctld", "slurmd"):  # asked by scontrol, one may miss it where munged ends first
            with suppress(FileNotFoundError, ProcessLookupError):
                os.kill(int((folder / f"{daemon}.pid").read_text()), signal.SIGTERM)
        subprocess.run(["munged", "--stop", socket_of], check=False, capture_output=True)
        CONFIGURATION.unlink()


def _wait(seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        said = subprocess.run(
            ["sinfo", "--noheader", "--format=%t"], capture_output=True, text=True, check=False
        ).stdout
        if "idle" in said:
            return
        time.sleep(0.5)
    raise TimeoutError("no node of Slurm became idle")
