"""Runs what deploy/ describes on one machine, before a release: ``python -m deploy.rehearsal`` (README.md there).

- ``__main__``: the command line; runs the steps, prints one line for each
- ``manifests``: compose files against the compose schema, Kubernetes manifests built and held against their schemas
- ``image``: builds the image; a container of it as processes of this machine
- ``containers``: a coordinator and workers from the image, as docker-compose.yml starts them; one worker is killed
- ``slurm``: deploy/slurm/atoll.sbatch on a Slurm of one node, cut off and continued
- ``systemd``: the units of deploy/systemd under a systemd in a namespace of its own
- ``job``: the job that each of them runs, and its digest as ``coordinator run`` of the checkout has it
- ``machine``: programs and packages that are needed, processes that are started and ended
"""
