#!/usr/bin/env bash
# A real Slurm of one node on the loopback interface, and a sweep of 12 jobs through it. Debian, as root:
#   apt-get install slurm-wlm munge && tests/slurm/one_node.sh
set -euo pipefail
cd "$(dirname "$0")/../.."
work=$(mktemp -d)
host=$(hostname -s)

stop() {
    scancel --user root 2>/dev/null || true
    pkill -F "$work/slurmctld.pid" 2>/dev/null || true
    pkill -F "$work/slurmd.pid" 2>/dev/null || true
    pkill munged 2>/dev/null || true
    sleep 2  # the controller writes its state once more as it ends
    rm -rf "$work"
}
trap stop EXIT

mkdir -p /run/munge "$work/state" "$work/spool"
chown munge: /run/munge
[ -s /etc/munge/munge.key ] || { dd if=/dev/urandom of=/etc/munge/munge.key bs=1024 count=1 status=none; chown munge: /etc/munge/munge.key; chmod 400 /etc/munge/munge.key; }
pgrep munged >/dev/null || runuser -u munge -- /usr/sbin/munged

cat >"$work/slurm.conf" <<CONF
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF=$work/slurm.conf
slurmctld
slurmd
for _ in $(seq 30); do sinfo --noheader 2>/dev/null | grep -q idle && break; sleep 1; done
sinfo

.venv/bin/python -m experiments.table1_filtering -m size=smoke launcher=submitit \
    hydra.launcher.cpus_per_task=1 hydra.launcher.mem_gb=null seed=0 out="$work/runs"
sacct --noheader 2>/dev/null || true
