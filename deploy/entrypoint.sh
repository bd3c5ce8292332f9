#!/bin/sh
# Run a program with the fastest kernels in the image that this processor can run.
#   atoll-entrypoint PROGRAM ARGUMENT...
#   atoll-entrypoint --kinds    kinds of processor that this one can stand for, the fastest first
# Whatever the kind, results are the same to the last bit; NUMBA_CPU_NAME, if set, is left alone.
set -eu

kinds() {
    if [ "$(uname -m)" = x86_64 ] && has avx2 && has fma && has bmi2 && has f16c && has movbe && has abm; then
        echo x86-64-v3
    fi
    echo generic
}

has() {
    grep -q -m 1 "^flags.* $1\( \|\$\)" "${ATOLL_CPUINFO:-/proc/cpuinfo}"
}

if [ "${1:-}" = --kinds ]; then
    kinds
    exit
fi

compiled="${ATOLL_KERNEL_CACHE:-}/kinds"
if [ -z "${NUMBA_CPU_NAME:-}" ] && [ -r "$compiled" ]; then
    for kind in $(kinds); do
        if grep -q -x "$kind" "$compiled"; then
            export NUMBA_CPU_NAME="$kind" NUMBA_CPU_FEATURES=
            break
        fi
    done
fi
exec "$@"
