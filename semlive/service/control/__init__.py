"""Control of a run: engine, commands of the operator, outputs of the analysis, the control socket, and resuming from the log."""
