"""What the adapters of all ROS dialects share: messages, the feed of topics, and parameters. Each dialect is a package of its own."""
