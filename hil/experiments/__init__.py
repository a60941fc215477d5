"""What is asked of the robot."""
