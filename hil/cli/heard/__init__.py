"""What is heard on a bus, live or in a log: shown, explained, and handed to other programs."""
