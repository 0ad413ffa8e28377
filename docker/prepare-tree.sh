# Makes the Debian 13 tree of lists of packages, once. Sourced by docker/run, so that a signal to
# the one is a signal to the other. `docker` is the folder of this file.
#
# A tree is named after what it is made from and comes into place by a rename: one that is there is
# whole. A lock lets one call make it while others wait.

# Sets `tree` to the path, under the folder $1, of a tree with the packages of the lists $2…
# Whoever has the tree for tests runs the program in it, too.
prepare_tree() {
    local cache=$1 recipe name log all=(packages packages-develop)
    shift
    ! find_tree "$@" || return 0

    mkdir -p -m 755 "$cache" 2>/dev/null || true # code is read from it, by nobody else written
    [[ -w $cache ]] ||
        fail "cannot write to $cache, where the environment is kept; set XDG_CACHE_HOME"
    local lock
    exec {lock}>"$cache/lock"
    if ! flock --nonblock "$lock"; then
        say "another call is preparing the environment; waiting for it …"
        flock "$lock"
    fi
    # another call may have made either of them meanwhile
    if ! find_tree "$@"; then
        local tools=(mmdebstrap)
        # an ordinary user's tree is made under a range of further user numbers
        (( EUID == 0 )) || tools+=(uidmap:newuidmap)
        install_tools "${tools[@]}"
        make_tree
    fi
    exec {lock}>&-
}

# Whether there is a tree with all packages or one with those of the lists $@; names it, or the one
# to be made.
find_tree() {
    name_tree "${all[@]}"
    [[ -d $tree ]] || name_tree "$@"
    [[ -d $tree ]]
}

# Sets `recipe`, `name`, `tree` and `log` for the tree with the packages of the lists $@.
name_tree() {
    local packages= line word list
    for list; do
        while read -r line; do
            for word in ${line%%#*}; do
                packages+=${packages:+,}$word
            done
        done <"$docker/$list"
    done
    recipe=(--variant=minbase --components=main --include="$packages"
        --dpkgopt='path-exclude=/usr/share/doc/*'
        --dpkgopt='path-include=/usr/share/doc/*/copyright'
        --dpkgopt='path-exclude=/usr/share/locale/*'
        --dpkgopt='path-exclude=/usr/share/man/*')
    name=$(sha256sum <<<"${recipe[*]}")
    name=tree-${name:0:12}
    tree=$cache/$name
    log=$cache/$name.log
}

make_tree() {
    local making=$cache/making-$$ scratch seconds=$SECONDS worker old
    # With the lock held, whatever is half-made was left by a call that was killed.
    rm -rf --one-file-system "$cache"/making-*
    # Passable, as an ordinary user's packages are unpacked there under other user numbers; /tmp may
    # be too small for them.
    scratch=$(mktemp --directory "${TMPDIR:-/var/tmp}/bristle-XXXXXX")
    chmod 711 "$scratch"
    mkdir "$making"
    trap 'give_up 130' INT
    trap 'give_up 143' TERM
    trap 'give_up 129' HUP

    say "preparing the environment (about 1 GB to download, 3 minutes, 4 GB of disk) …"
    # A process group of its own can be ended as a whole.
    set -m
    { bootstrap 2>&1 | tee "$log" |
        sed --unbuffered --quiet 's,^I: \(\(download\|extract\|install\)ing .*\),docker/run: \1,p'
    } >&2 </dev/null &
    worker=$!
    set +m
    if ! wait "$worker"; then
        rm -rf --one-file-system "$making" "$scratch"
        fail "the environment could not be prepared:" \
            "$(grep '^E:' "$log" | head -n 1 || true) (see $log)"
    fi
    trap - INT TERM HUP
    rm -rf "$scratch"
    touch "$making/etc/bristle-environment"
    mv "$making" "$tree"
    say "prepared in $((SECONDS - seconds)) s: $tree"
    for old in "$cache"/tree-*/; do
        [[ ${old%/} == "$tree" ]] || say "not used by this version, may be deleted: ${old%/}"
    done
}

# As an ordinary user the files come as a stream, so that they belong to the user and can be deleted
# like any others; device files, which he cannot make, are taken from the host anyway.
bootstrap() {
    if (( EUID == 0 )); then
        # its mounts of /proc, /sys and /dev go with it, however it ends
        TMPDIR=$scratch unshare --mount \
            mmdebstrap --mode=root --format=directory "${recipe[@]}" trixie "$making"
    else
        TMPDIR=$scratch mmdebstrap --mode=unshare --format=tar "${recipe[@]}" trixie - |
            tar --extract --directory "$making" --exclude='./dev/*'
    fi
}

give_up() {
    trap '' INT TERM HUP
    kill -TERM -- "-$worker" 2>/dev/null || :
    while kill -0 -- "-$worker" 2>/dev/null; do
        sleep 0.2
    done
    rm -rf --one-file-system "$making" "$scratch"
    say "interrupted while preparing the environment; nothing is left behind"
    exit "$1"
}
