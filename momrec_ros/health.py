"""The node's own diagnostics: is it at work, what came, and what was left out for which reason."""

from __future__ import annotations

from momrec_ros.errors import Reason
from momrec_ros.interfaces import DiagnosticStatus, Level
from momrec_ros.pipeline import Activity
from momrec_ros.session import Cause

__all__ = ["health_status"]

HARDWARE = "momrec"
ENDS = (Cause.FORGOTTEN, Cause.EVICTED, Cause.TIMED_OUT)


def health_status(
    name: str,
    state: str,
    problem: str,
    activity: Activity,
    before: Activity,
    *,
    unreceived: int = 0,
) -> DiagnosticStatus:
    """Return how the node does.

    Parameters
    ----------
    name : str
        Of the node, with its namespace.
    state : str
        Of its life cycle.
    problem : str
        Why it refused to be configured; empty if it did not.
    activity, before : Activity
        Now and at the last time: what was rejected in between is a warning.
    unreceived : int
        Messages that the middleware lost.

    Returns
    -------
    status : DiagnosticStatus
        Level ERROR with a problem, WARN where something was lost since the last time, else OK.
    """
    lost = activity.tally.rejected - before.tally.rejected
    if problem:
        level, message = Level.ERROR, problem
    elif lost:
        reasons = ", ".join(f"{count} by {reason}" for reason, count in lost.items())
        level, message = Level.WARN, f"{state}; views left out: {reasons}"
    else:
        level, message = Level.OK, state
    return DiagnosticStatus(
        level, f"{name}: views", message, "momrec", _values(activity, unreceived)
    )


def _values(activity: Activity, unreceived: int) -> tuple[tuple[str, str], ...]:
    tally = activity.tally
    counts = {
        "messages": activity.received,
        "messages_waiting": activity.waiting,
        "messages_lost": unreceived,
        "halves_waiting": activity.halves,
        "objects": activity.objects,
        "results": activity.published,
        "views_used": tally.used,
        "views_cut": tally.cut,
        "views_repeated": tally.repeated,
        "views_rejected": tally.rejected.total(),
        **{f"rejected_{reason}": tally.rejected[reason] for reason in Reason},
        **{
            f"objects_{cause}": tally.ended[cause] for cause in Cause if cause is not Cause.FINISHED
        },
    }
    return (
        ("world_frame", activity.world_frame),
        ("last_loss", activity.last_loss),
        *((key, str(count)) for key, count in counts.items()),
        ("delay_ms", f"{1e3 * activity.delay:.1f}"),
        ("longest_delay_ms", f"{1e3 * activity.longest_delay:.1f}"),
    )
