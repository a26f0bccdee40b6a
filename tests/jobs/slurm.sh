#!/usr/bin/env bash
# A SLURM of one node for the time of a command, outside the system's own: tests/jobs/slurm.sh COMMAND ...
#
# Needs Debian's packages slurm-wlm and munge (apt-get install slurm-wlm munge), no systemd, no cgroups and no root.
# munged, slurmctld and slurmd run under a folder in /tmp, with their own key, sockets and ports; COMMAND finds them by
# SLURM_CONF. squeue is printed whenever it changes. When COMMAND ends, jobs and daemons are ended and the folder goes.
# As here, the comparison of six methods, two jobs at a time:
#   tests/jobs/slurm.sh .venv/bin/python -m vprbench compare methods=sad,hog,pca,random_projection,flyhash,hyperdimensional \
#       dataset=corridor cluster=slurm cluster.cores=1 cluster.memory=2GB workers=2 results=/tmp/by-slurm
# NODES= (1) slurmds of CPUS= (all cores) and MEMORY= (MB, of this machine) each stand for the nodes of a cluster.
set -euo pipefail
PATH=$PATH:/usr/sbin:/sbin
[ $# -gt 0 ] || { sed -n '2,12s/^# \?//p' "$0" >&2; exit 2; }
for program in munged slurmctld slurmd squeue; do
    command -v "$program" >/dev/null || { echo "$program is missing: apt-get install slurm-wlm munge" >&2; exit 2; }
done

nodes=${NODES:-1}
cpus=${CPUS:-$(nproc)}
memory=${MEMORY:-$(free -m | awk '/^Mem:/ {print int($2 * 0.9)}')}
port=${PORT:-$((20000 + RANDOM % 10000))}
home=$(mktemp -d /tmp/slurm.XXXXXX)
chmod 755 "$home"
mkdir -p "$home"/{munge,state,spool}
user=$(id -un)
host=$(hostname -s)
daemons=()

end() {
    local code=$?
    trap - EXIT INT TERM
    scancel --user="$user" 2>/dev/null || true
    for _ in $(seq 50); do [ -z "$(squeue --noheader 2>/dev/null)" ] && break; sleep 0.2; done
    kill "${daemons[@]}" 2>/dev/null || true
    for _ in $(seq 50); do kill -0 "${daemons[@]}" 2>/dev/null || break; sleep 0.2; done
    kill -9 "${daemons[@]}" 2>/dev/null || true
    rm -rf "$home"
    exit "$code"
}
trap end EXIT
trap 'exit 130' INT TERM

dd if=/dev/urandom of="$home/munge/key" bs=1024 count=1 status=none
chmod 600 "$home/munge/key"
munged --foreground --key-file="$home/munge/key" --socket="$home/munge/socket" --pid-file="$home/munge/pid" \
    --seed-file="$home/munge/seed" --log-file="$home/munge/log" >"$home/munged.log" 2>&1 &
daemons+=($!)

cat >"$home/slurm.conf" <<END
ClusterName=vprbench
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$port
AuthType=auth/munge
AuthInfo=socket=$home/munge/socket
CredType=cred/munge
SlurmUser=$user
SlurmdUser=$user
StateSaveLocation=$home/state
SlurmdSpoolDir=$home/spool/%n
SlurmctldPidFile=$home/slurmctld.pid
SlurmdPidFile=$home/slurmd.%n.pid
SlurmctldLogFile=$home/slurmctld.log
SlurmdLogFile=$home/slurmd.%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerParameters=batch_sched_delay=0,sched_interval=2,bf_interval=2
SlurmdParameters=config_overrides
ReturnToService=2
KillWait=5
MinJobAge=30
$(for n in $(seq "$nodes"); do
    echo "NodeName=node$n NodeHostname=$host NodeAddr=127.0.0.1 Port=$((port + n)) CPUs=$cpus RealMemory=$memory"
done)
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
END
export SLURM_CONF=$home/slurm.conf

for _ in $(seq 50); do [ -S "$home/munge/socket" ] && break; sleep 0.1; done
slurmctld -D >"$home/slurmctld.out.log" 2>&1 &
daemons+=($!)
for n in $(seq "$nodes"); do
    slurmd -D -N "node$n" >"$home/slurmd.out.$n.log" 2>&1 &
    daemons+=($!)
done
idle() { [ "$(sinfo --noheader --format=%D --states=idle 2>/dev/null)" = "$nodes" ]; }
for _ in $(seq 100); do idle && break; sleep 0.2; done
idle || { tail -n 20 "$home"/*.log >&2; echo "no node came up" >&2; exit 1; }
sinfo --Node --long >&2

watch() { # squeue, as often as it changes
    local before="" now
    while sleep 1; do
        now=$(squeue --format="%.6i %.9P %.20j %.8u %.2t %.6M %.3C %.8m %R" 2>&1) || continue
        if [ "${now//[0-9]:[0-9][0-9]/}" != "$before" ]; then printf '\n%s squeue\n%s\n' "$(date +%T)" "$now" >&2; fi
        before=${now//[0-9]:[0-9][0-9]/}
    done
}
watch &
daemons+=($!)

"$@"
