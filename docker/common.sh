# What docker/run and docker/build share. Sourced.

say() { echo "docker/$(basename "$0"): $*" >&2; }

fail() {
    echo "bristle: error: $*" >&2
    exit 1
}

# Prints the container engine that answers: a client without its daemon does not.
find_engine() {
    local engine
    for engine in docker podman; do
        command -v "$engine" >/dev/null || continue
        timeout 5 "$engine" info >/dev/null 2>&1 && echo "$engine" && return
    done
    return 1
}

# Installs those of the Debian packages $@ whose command, of the same name (or after a colon), is
# not there. Only as root: others are told.
install_tools() {
    local tool missing=() log
    for tool; do
        command -v "${tool#*:}" >/dev/null || missing+=("${tool%:*}")
    done
    (( ${#missing[@]} )) || return 0
    if (( EUID != 0 )) || ! command -v apt-get >/dev/null; then
        fail "neither docker nor podman answers, and without them this is needed:" \
            "${missing[*]} (on Debian: sudo apt-get install ${missing[*]})"
    fi
    say "installing ${missing[*]} …"
    log=$(mktemp --tmpdir bristle-apt-XXXXXX.log)
    {
        apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install --yes \
            --no-install-recommends -o DPkg::Lock::Timeout=120 "${missing[@]}"
    } >"$log" 2>&1 </dev/null || fail "apt-get could not install ${missing[*]}; see $log"
    rm "$log"
}
