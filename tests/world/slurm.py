"""Run a single-node Slurm on loopback, from Debian's packages, for a test."""

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

PROFILE = Path(__file__).resolve().parents[2] / "workflow/profiles/slurm"
# Options in addition to the profile: without accounting, job status comes from the queue and may be polled often.
OPTIONS = (
    *("--workflow-profile", str(PROFILE)),
    *("--slurm-status-command", "squeue"),
    *("--slurm-init-seconds-before-status-checks", "1"),
)
DAEMONS = ("munged", "slurmctld", "slurmd")
# Default path of every client; the plugin removes SLURM_CONF from the environment of its jobs.
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
    """Explain why no Slurm can be started here; empty if it can."""
    absent = [name for name in (*DAEMONS, "sbatch") if shutil.which(name) is None]
    if absent:
        return f"no {absent[0]}: apt-get install slurm-wlm munge"
    if find_spec("snakemake_executor_plugin_slurm") is None:
        return "no snakemake-executor-plugin-slurm: make cluster"
    if os.geteuid() != 0:
        return "the daemons are started as root"
    # A configuration left by an interrupted test is overwritten.
    foreign = CONFIGURATION.exists() and NAME not in CONFIGURATION.read_text()
    return f"{CONFIGURATION} exists: this machine has a Slurm of its own" if foreign else ""


@contextmanager
def cluster(folder: Path) -> Iterator[None]:
    """Run a single-node cluster on this machine for the duration of the block."""
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
        for daemon in ("slurmctld", "slurmd"):  # a scontrol shutdown could be lost if munged ends first
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
