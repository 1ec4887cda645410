"""Task records as messages."""

from im_bringup.registry import TaskRecord
from im_msgs.msg import TaskRecord as TaskRecordMessage


def to_message(record: TaskRecord) -> TaskRecordMessage:
    """The message of a record."""
    placed = record.placed
    return TaskRecordMessage(
        id=placed.id,
        name=placed.name,
        node=placed.task.node,
        host=placed.host,
        process=placed.process,
        package=placed.task.package,
        executable=placed.task.executable,
        pid=record.pid,
        incarnation=record.incarnation,
        restarts=record.restarts,
        phase=record.progress.word,
        detail=record.detail,
    )
