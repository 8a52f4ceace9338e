#!/bin/sh
# Describe a uwserver, send one command and print three samples, with nothing but sh and nc.
#
#   drive.sh [HOST [PORT [SENSOR [ACTUATOR [VALUE]]]]]
#
# Exit status: 0 after three samples, 1 when something was refused or no sample came, 127 without nc.
set -u

host=${1:-127.0.0.1}
port=${2:-7600}
sensor=${3:-bluerov2/imu}
actuator=${4:-bluerov2/thrusters}
value=${5:-'{"u":[0.3,0.3,-0.3,-0.3,0,0,0,0]}'}

if ! command -v nc >/dev/null 2>&1; then
    echo "drive.sh: nc is not installed (Debian: netcat-openbsd or netcat-traditional)" >&2
    exit 127
fi

requests() {
    if [ -n "${UWSERVER_TOKEN:-}" ]; then
        printf '{"jsonrpc":"2.0","id":0,"method":"hello","params":{"version":1,"token":"%s"}}\n' "$UWSERVER_TOKEN"
    fi
    printf '{"jsonrpc":"2.0","id":1,"method":"describe"}\n'
    printf '{"jsonrpc":"2.0","id":2,"method":"command","params":{"port":"%s","value":%s}}\n' "$actuator" "$value"
    printf '{"jsonrpc":"2.0","id":3,"method":"subscribe","params":{"pattern":"%s","rate_hz":10}}\n' "$sensor"
    # nc may end the connection when its input ends: keep it open while the samples come.
    sleep 2
}

three_samples() {
    samples=0
    while IFS= read -r line; do
        printf '%s\n' "$line"
        case $line in
            *'"method":"sample"'* | *'"method": "sample"'*)
                samples=$((samples + 1))
                if [ "$samples" -eq 3 ]; then
                    return 0
                fi
                ;;
            *'"error":'*)
                echo "drive.sh: the server refused a request" >&2
                return 1
                ;;
        esac
    done
    echo "drive.sh: only $samples samples came from $host:$port; is the server running (uwserver run) and not paused?" >&2
    return 1
}

# -w 2 ends nc after 2 s of silence (the traditional nc: 4 s); both kinds have it. Once the reader has its three
# samples, the next one ends nc by a closed pipe.
requests | nc -w 2 "$host" "$port" | three_samples
