#!/usr/bin/env bash
# Starts a Slurm of its own on this machine, to try slurm.sh: munged, slurmctld and two slurmd, as root. Prints what to set.
#
#   eval "$(tools/farm/slurm_local.sh start FOLDER)"      tools/farm/slurm_local.sh stop FOLDER
set -euo pipefail
folder=$(realpath -m "$2")
if [ "$1" = stop ]; then
  for pid in "$folder"/*.pid; do [ -e "$pid" ] && kill "$(cat "$pid")" 2>/dev/null || true; done
  exit 0
fi
mkdir -p "$folder"/{state,spool-one,spool-two}
chmod 755 "$folder"
processors=$(nproc); memory=$(($(grep MemTotal /proc/meminfo | tr -dc 0-9) / 1024 / 2))
host=$(hostname -s)
# One key and socket of its own: a munge of the machine is left alone.
install -d -m 700 "$folder/munge"; install -d -m 755 "$folder/run"
[ -e "$folder/munge/key" ] || (umask 077; head -c 128 /dev/urandom > "$folder/munge/key")
munged --force --key-file "$folder/munge/key" --socket "$folder/run/munge.socket" --pid-file "$folder/munged.pid" \
  --log-file "$folder/munge/log" --seed-file "$folder/munge/seed" >&2
cat > "$folder/slurm.conf" <<CONF
ClusterName=gdibl
SlurmctldHost=$host(127.0.0.1)
AuthType=auth/munge
AuthInfo=socket=$folder/run/munge.socket
CredType=cred/munge
SlurmUser=root
SlurmdUser=root
SlurmctldPort=46817
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool-%n
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd-%n.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=1,sched_interval=2
MinJobAge=3600
ReturnToService=2
NodeName=one NodeHostname=$host NodeAddr=127.0.0.1 Port=46818 CPUs=$processors Boards=1 SocketsPerBoard=1 CoresPerSocket=$processors ThreadsPerCore=1 RealMemory=$memory State=UNKNOWN
NodeName=two NodeHostname=$host NodeAddr=127.0.0.1 Port=46819 CPUs=$processors Boards=1 SocketsPerBoard=1 CoresPerSocket=$processors ThreadsPerCore=1 RealMemory=$memory State=UNKNOWN
PartitionName=all Nodes=one,two Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF="$folder/slurm.conf"
slurmctld -c >&2
slurmd -N one >&2
slurmd -N two >&2
for _ in $(seq 50); do
  sinfo -h -o %T 2>/dev/null | grep -q idle && break
  sleep 0.2
done
sinfo >&2
echo "export SLURM_CONF=$SLURM_CONF"
