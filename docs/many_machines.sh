#!/bin/bash
# Track recordings on 20 machines: sbatch docs/many_machines.sh OUT RECORDING...
#SBATCH --array=1-20
#SBATCH --cpus-per-task=8
#SBATCH --time=12:00:00
set -euo pipefail
parts=20  # as in --array; it stays 20 when a single task is submitted again
out=$1
shift
exec clothtrack track "$@" --output "$out" --shard "$SLURM_ARRAY_TASK_ID/$parts" \
    --workers "${SLURM_CPUS_PER_TASK:-1}"
