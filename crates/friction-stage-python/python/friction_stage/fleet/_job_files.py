"""Job files for batch systems, which start ``python -m friction_stage.fleet chunk`` by themselves:
a job array of Slurm, an Indexed Job of Kubernetes. Nothing of ours runs between the tasks."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

import yaml

from ..errors import FleetError

LARGEST_ARRAY = 1000
"""Tasks of a job array: Slurm takes indices below MaxArraySize, 1001 as it is shipped."""
RETRIES = 3
"""Of a task whose machine was lost. Assumed."""


def _tasks(chunks: int, tasks: int | None) -> int:
    if tasks is not None and tasks < 1:
        raise FleetError(f"tasks is {tasks}, must be at least 1")
    return min(chunks, tasks or LARGEST_ARRAY)


def _command(python: str, job: str, tasks: int) -> list[str]:
    return [python, "-m", "friction_stage.fleet", "chunk", job, "--tasks", str(tasks), "--index"]


def slurm(
    job: str,
    chunks: int,
    *,
    tasks: int | None = None,
    time: str = "01:00:00",
    memory: str = "1G",
    python: str = "python3",
    options: Sequence[str] = (),
) -> str:
    """A batch script for ``sbatch``: a job array in which each task has one core.

    Args:
        job: Path of the job file, as the machines see it.
        chunks: Of the job.
        tasks: Of the array; without, one for each chunk, 1000 at most.
        time: Limit of a task.
        memory: Of a task.
        python: The interpreter that has ``friction_stage``.
        options: More lines of ``#SBATCH``, such as ``--partition=short``.
    """
    count = _tasks(chunks, tasks)
    lines = [
        "#!/bin/bash",
        "#SBATCH --job-name=friction-stage",
        f"#SBATCH --array=0-{count - 1}",
        "#SBATCH --ntasks=1",
        "#SBATCH --cpus-per-task=1",
        f"#SBATCH --mem={memory}",
        f"#SBATCH --time={time}",
        "#SBATCH --requeue",
        *(f"#SBATCH {option}" for option in options),
        "set -eu",
        f'exec {shlex.join(_command(python, job, count))} "$SLURM_ARRAY_TASK_ID"',
    ]
    return "\n".join(lines) + "\n"


def kubernetes(
    job: str,
    chunks: int,
    *,
    image: str,
    tasks: int | None = None,
    parallelism: int | None = None,
    memory: str = "1Gi",
    python: str = "python3",
    name: str = "friction-stage",
) -> str:
    """An Indexed Job for ``kubectl apply``: each pod has one core.

    A pod whose node is lost is started again. One that ends with code 3 is not: its chunks failed
    for a reason that stays.

    Args:
        job: Path or URL of the job file, as the pods see it.
        chunks: Of the job.
        image: With ``friction_stage`` in it.
        tasks: Pods; without, one for each chunk, 1000 at most.
        parallelism: Pods at once; without, all.
        memory: Of a pod.
        python: The interpreter that has ``friction_stage``.
        name: Of the job.
    """
    count = _tasks(chunks, tasks)
    command = f'exec {shlex.join(_command(python, job, count))} "$JOB_COMPLETION_INDEX"'
    resources = {"cpu": "1", "memory": memory}
    content = {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": {"name": name},
        "spec": {
            "completions": count,
            "parallelism": min(count, parallelism or count),
            "completionMode": "Indexed",
            "backoffLimitPerIndex": RETRIES,
            "podFailurePolicy": {
                "rules": [
                    {
                        "action": "FailIndex",
                        "onExitCodes": {"operator": "In", "values": [3]},
                    }
                ]
            },
            "template": {
                "spec": {
                    # As podFailurePolicy asks.
                    "restartPolicy": "Never",
                    "containers": [
                        {
                            "name": "chunk",
                            "image": image,
                            "command": ["/bin/sh", "-c", command],
                            "resources": {"requests": resources, "limits": resources},
                        }
                    ],
                }
            },
        },
    }
    return yaml.safe_dump(content, sort_keys=False, width=100)
