#!/bin/busybox sh
# The first process of the virtual machine. Its root is the file tree of the machine that started it; `machine.py` names the job's
# directory on the kernel's command line and finds there what this leaves: the exit status.
/bin/busybox mount -t proc none /proc
for word in $(/bin/busybox cat /proc/cmdline); do
    case $word in bench_job=*) job=${word#*=} ;; esac
done
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin

# What a program expects of a system, in memory: the machine outside keeps its own.
busybox mount -t sysfs none /sys
[ -c /dev/null ] || busybox mount -t devtmpfs none /dev
for directory in /dev/shm /dev/pts; do [ -d $directory ] || busybox mkdir $directory; done
busybox mount -t tmpfs none /dev/shm
busybox mount -t devpts none /dev/pts
busybox mount -t tmpfs none /run
busybox mount -t tmpfs none "$job/tmp"

while read -r line; do busybox insmod $line; done <"$job/modules"
ip link set lo up
for name in $(busybox cat "$job/interfaces"); do
    ip link add "$name" type vcan
    ip link set "$name" up
done

# A session of its own, so that no signal of the terminal reaches it; a raw terminal, so that the output stays as it is.
busybox stty -F /dev/tty1 raw -echo
busybox setsid busybox sh "$job/command" </dev/null >/dev/tty1 2>&1
status=$?
busybox stty -F /dev/tty1 sane # waits until the output has left
echo $status >"$job/status"
busybox sync
busybox poweroff -f
