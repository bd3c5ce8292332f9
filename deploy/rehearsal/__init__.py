"""Runs what deploy/ describes on one machine, before a release: ``python -m deploy.rehearsal`` (README.md there).

- ``__main__``: the command line; runs the steps, prints one line for each
- ``manifests``: compose files and Kubernetes manifests against their schemas
- ``image``: builds the image; a container of it as processes of this machine
- ``services``: the job on containers as docker-compose.yml starts them, and on systemd's units
- ``slurm``, ``grid_engine``: a batch system of one node
- ``scripts``: the job by sbatch, srun and mpirun
- ``adapting``: ``coordinator adapt`` on either
- ``job``: that job, and its digest as ``coordinator run`` of the checkout has it
- ``machine``: programs and packages that are needed, processes that are started and ended
"""
