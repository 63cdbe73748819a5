"""The queue between those who receive uploads and those who store them: NATS JetStream."""
