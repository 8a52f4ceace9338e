"""What every ROS dialect shares: the messages, and (each in its own package) the carriers."""
