"""Values behind the tokens of a net: commands, arguments, answers and data objects, as JSON data."""

import json
from collections.abc import Mapping

from im_core.clock import monotonic
from im_core.errors import NotFoundError
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import NO_LINEAGE, Activity, Job, Lineage

MOST = 20
"""Tokens, actions or answers that are told of a part of a net."""
LONGEST = 300
"""Characters of a value as JSON; a report of a calibration has 280,000."""


def values_of(executor: Executor, part: str) -> dict[str, object]:
    """Return the values of a place or a transition, between two turns of the net.

    Args:
        executor: The net.
        part: Place, transition or subnet; of an action the transition as written.

    Returns:
        ``tokens``, of a place: for each the job (command, symbol, arguments, results, what failed last), nothing for a
        token of nobody; ``objects``, the names of its data objects in the DOM; ``running``, of a transition: for each
        action the job, what is done, its state and for how long [s]; ``answers``: for each open job what its
        transition was answered last. Values are JSON texts, long ones cut.

    Raises:
        NotFoundError: The net has no such part.
    """
    net, rule = executor.net, executor.rule
    if part in net.places:
        number = rule.place[part]
        tokens = rule.enabling.tokens[number]
        queue = [*rule.tokens.queues.get(number, (NO_LINEAGE,) * min(tokens, MOST))][:MOST]
        told: dict[str, object] = {"count": tokens, "tokens": [_token(lineage) for lineage in queue]}
        if stands_for := net.places[part].data_object:
            jobs = {id(lineage.job): lineage.job for lineage in queue}
            told["objects"] = sorted({rule.object_name(stands_for, job) for job in jobs.values()})
        return told
    inside = [name for name in executor.written.transitions if name == part or name.startswith(f"{part}.")]
    if inside or part in net.transitions:
        running = [_action(each) for each in executor.activities if each.transition in inside]
        answers = [
            {**_job(job), "answer": shown_values(job.replies[name])}
            for job in executor.jobs()
            for name in inside
            if name in job.replies
        ]
        return {"running": running[:MOST], "answers": answers[:MOST]}
    raise NotFoundError(
        kind="place or transition", name=part, known=[*executor.written.places, *executor.written.transitions]
    )


def shown_values(values: Mapping[str, object]) -> dict[str, str]:
    """Return values as JSON texts by name, long ones cut."""
    return {name: json.dumps(value, default=repr)[:LONGEST] for name, value in list(values.items())[:MOST]}


def _job(job: Job) -> dict[str, object]:
    return {
        "command": job.command.id,
        "symbol": job.symbol,
        "arguments": shown_values(job.arguments),
        "results": shown_values(job.results),
    }


def _token(lineage: Lineage) -> dict[str, object]:
    told = _job(lineage.job) if lineage.job is not None else {}
    return {**told, "failure": lineage.failure.message} if lineage.failure is not None else told


def _action(activity: Activity) -> dict[str, object]:
    lasts_s = monotonic() - activity.began
    return {
        **_token(activity.lineage),
        "does": str(activity.action),
        "state": activity.state.value,
        "lasts": round(max(lasts_s, 0.0), 1),
    }
