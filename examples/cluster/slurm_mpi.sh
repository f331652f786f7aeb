#!/bin/bash
# Train on a Slurm cluster, by MPI: sbatch examples/cluster/slurm_mpi.sh RUN ENV [flags of shes train]
# One rank is the main process, the others are workers. Submitted again, the job resumes the run.
#SBATCH --job-name=shes
#SBATCH --ntasks=241
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=2G
#SBATCH --time=24:00:00
#SBATCH --requeue
set -euo pipefail

run=$1
shift
if [ -e "$run/config.json" ]; then
    command=(resume "$run" --backend mpi)
else
    command=(train "$@" --backend mpi --out "$run")
fi
# If mpi4py finds no ranks (srun without PMIx): mpiexec python -m ...
# By itself, Slurm would let the other ranks wait for one that died.
srun --kill-on-bad-exit=1 --mpi=pmix python -m mpi4py.futures -m shes "${command[@]}"
