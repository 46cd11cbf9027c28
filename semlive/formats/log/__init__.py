"""The MCAP log: messages, topics, maps, writer and repair."""
