"""What crosses a process or a file: messages, the table of channels, their encoding, the drive manifest."""
