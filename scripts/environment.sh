# Sourced by the scripts of this folder: makes the project's environment at the first run, and finds it at once later.
# Sets SKD_ROOT and SKD_ENV (the environment's bin folder). Needs Python 3.11 to 3.13; SKD_PYTHON chooses one.
# Where SKD_ENV is set already, that environment is used as it is. With SKD_LOCKED=1 it is made of the versions of requirements/*.lock,
# and of nothing whose hash is another.

SKD_ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

_skd_python_fits() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; }

_skd_find_python() {
    local candidate
    local candidates="python3.11 python3.12 python3.13 python3 python"
    if [ -n "${ROS_DISTRO:-}" ]; then
        # ROS 2's packages are compiled for one Python, which their folder names; another may come first on the PATH.
        candidates="python3"
        [[ ${PYTHONPATH:-} =~ /lib/(python3\.[0-9]+)/ ]] && candidates="${BASH_REMATCH[1]} python3"
    fi
    for candidate in ${SKD_PYTHON:-$candidates}; do
        if _skd_python_fits "$candidate"; then
            command -v "$candidate"
            return
        fi
    done
    echo "skd: no Python 3.11 to 3.13 found (looked for: ${SKD_PYTHON:-$candidates}); set SKD_PYTHON to one" >&2
    return 1
}

# The wheels of ROS 2 start every Python of the environment a second time, to set the path of their libraries; this
# variable of theirs keeps them from it. What needs those libraries sets the path itself (skd_sim/ros_environment).
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1

# Uses the variables of skd_environment.
_skd_install() {
    local pip=("$1" -m pip --python "$SKD_ENV/python" install --disable-pip-version-check --progress-bar off)
    if [ -z "${SKD_LOCKED:-}" ]; then
        "${pip[@]}" -e "$SKD_ROOT${extras:+[$extras]}" ${constraint:+"$constraint"}
    elif [ -n "$constraint" ]; then
        echo "skd: SKD_LOCKED is for environments without a sourced ROS 2, which has its own numpy" && return 1
    else
        "${pip[@]}" --require-hashes -r "$SKD_ROOT/requirements/$([ -n "$extras" ] && echo all || echo run).lock" -r "$SKD_ROOT/requirements/build.lock" &&
            "${pip[@]}" --no-deps --no-build-isolation -e "$SKD_ROOT"
    fi
}

# skd_environment EXTRAS: EXTRAS is empty or a group of pyproject.toml's optional dependencies, as in "test,benchmark".
skd_environment() {
    local extras=${1:-} venv="$SKD_ROOT/.venv" constraint="" stamp want python log
    [ -n "${SKD_ENV:-}" ] && return 0
    if [ -n "${ROS_DISTRO:-}" ]; then
        # ROS 2 Jazzy's message modules are compiled for numpy 1. Of what apt installs beside ROS, rclpy and messages need
        # only numpy and PyYAML, and SKD brings both; so the environment can do without the system's packages.
        venv="$SKD_ROOT/.venv-$ROS_DISTRO" constraint="numpy<2"
    fi
    SKD_ENV="$venv/bin"
    stamp="$venv/.skd-${extras:-run}"
    want=$(cksum <"$SKD_ROOT/pyproject.toml")
    [ -f "$stamp" ] && [ "$(<"$stamp")" = "$want" ] && return 0

    python=$(_skd_find_python) || return 2
    mkdir -p "$venv"
    exec 9>"$venv/.lock"
    if command -v flock >/dev/null; then flock 9; fi
    if [ -f "$stamp" ] && [ "$(<"$stamp")" = "$want" ]; then exec 9>&-; return 0; fi
    echo "skd: setting up the environment in $venv (once, about a minute)" >&2
    log="$venv/install.log"
    if ! {
        { _skd_python_fits "$SKD_ENV/python" || "$python" -m venv "$venv" || "$python" -m venv --without-pip "$venv"; } &&
            _skd_install "$python"
    } >"$log" 2>&1; then
        tail -n 15 "$log" >&2
        echo "skd: the environment could not be set up; the whole log is $log" >&2
        return 1
    fi
    printf '%s\n' "$want" >"$stamp"
    exec 9>&-
}
