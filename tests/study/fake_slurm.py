"""Stands in for sbatch, scancel and scontrol, whose name comes first: runs job scripts on this machine.

What it knows of a job lies in the folder FAKE_SLURM: `ID.sh` the script, `ID.pid` its shell, `ID.codes` its exit codes.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

STATE = Path(os.environ["FAKE_SLURM"])


def sbatch(script, *_):
    """Start a job, or each of an array, and say its number as SLURM does."""
    text = Path(script).read_text()
    array = re.search(r"^#SBATCH --array=(\d+)-(\d+)$", text, re.MULTILINE)
    tasks = range(int(array[1]), int(array[2]) + 1) if array else [None]
    cores = re.search(r"^#SBATCH --cpus-per-task=(\d+)$", text, re.MULTILINE)
    first = 1 + max((int(path.stem) for path in STATE.glob("*.sh")), default=100)
    for job, task in enumerate(tasks, start=first):
        shutil.copy(script, STATE / f"{job}.sh")
        environment = {"SLURM_JOB_ID": str(job), "SLURM_CPUS_PER_TASK": cores[1] if cores else "1"}
        if task is not None:
            environment |= {"SLURM_ARRAY_TASK_ID": str(task), "SLURM_ARRAY_TASK_COUNT": str(len(tasks))}
        with (STATE / f"{job}.log").open("w") as log:
            subprocess.Popen(
                [sys.executable, __file__, "run", str(job)],
                env=os.environ | environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
    print(f"Submitted batch job {first}")


def run(job):
    """Run the script of a job, and again as often as it was put back into the queue."""
    again = STATE / f"{job}.requeue"
    while True:
        again.unlink(missing_ok=True)
        shell = subprocess.Popen(["bash", STATE / f"{job}.sh"])
        (STATE / f"{job}.pid").write_text(str(shell.pid))
        code = shell.wait()
        with (STATE / f"{job}.codes").open("a") as codes:
            codes.write(f"{code}\n")
        if not again.exists():
            return


def scancel(*jobs):
    """End all processes of jobs."""
    for job in jobs:
        shell = int((STATE / f"{job}.pid").read_text())
        os.killpg(os.getpgid(shell), signal.SIGKILL)


def scontrol(command, job):
    """Put a job back into the queue."""
    assert command == "requeue"
    (STATE / f"{job}.requeue").touch()


if __name__ == "__main__":
    called, *arguments = sys.argv[1:]
    {"sbatch": sbatch, "run": run, "scancel": scancel, "scontrol": scontrol}[called](*arguments)
