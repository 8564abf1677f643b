"""An assessment in a launch test: the graph without the car's node, and the figures when the car has been assessed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from skd_sim.errors import AssessmentError

from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.pytest_plugin import Assessed


def assessment(out: str | Path, **arguments: Any) -> IncludeLaunchDescription:
    """Return what starts simulator, adversary and evaluator; the car's node is yours.

    Args:
        out: new folder for the result.
        arguments: further ones of assessment.launch.py.
    """
    file = Path(get_package_share_directory("skd_evaluator"), "launch", "assessment.launch.py")
    given = {"out": out, "use_builtin_controller": False, "end_launch": False, **arguments}
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(file)), launch_arguments=[(name, str(one)) for name, one in given.items()]
    )


def assessed(out: str | Path, proc_info: Any, timeout: float = 3600.0) -> Assessed:
    """Wait until the car has been assessed, and return its figures.

    Args:
        out: as for `assessment`.
        proc_info: the test's own fixture of launch_testing.
        timeout: s to wait.

    Raises:
        AssertionError: the assessment takes longer.
        AssessmentError: it failed; the evaluator's output says why.
    """
    proc_info.assertWaitForShutdown(process="evaluator", timeout=timeout)
    (code,) = (proc_info[name].returncode for name in proc_info.process_names() if name.startswith("evaluator"))
    if code:
        raise AssessmentError(f"the evaluator ended with exit code {code}")
    return Assessed(dict(read_result(Path(out)).figures), Path(out))
