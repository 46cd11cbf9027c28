"""Imported logs whose configuration states settings of the estimate: with fewer parameters a verdict takes a fraction of the time."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from semlive.data.settings import EstimateSettings
from semlive.formats.log.messages import RunMessage
from semlive.formats.log.writer import LogWriter
from semlive.service.log.files import messages


def state_estimate(log: Path, settings: EstimateSettings) -> Path:
    """Write an imported log again with settings of the estimate in its configuration; everything else stays as it is."""
    every = list(messages(log))
    with log.open("wb") as stream:
        writer = LogWriter(stream)
        for item in every:
            payload = item.payload
            if item.topic == "/run":
                run = RunMessage.model_validate_json(payload)
                stated = json.loads(json.dumps(asdict(settings)))
                payload = run.model_copy(update={"config": {**run.config, "estimate": stated}})
            writer.write(item.topic, payload, item.log_time_ns, item.publish_time_ns, item.sequence)
        writer.finish()
    return log
