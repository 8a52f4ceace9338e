"""The benchmarks of the web view, of video and of pictures."""
