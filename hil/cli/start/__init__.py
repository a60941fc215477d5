"""What is done before the first run: a bench file is written, and the robot is checked by it."""
