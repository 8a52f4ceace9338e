"""Parts of the benchmark that step worlds and sensors in this process."""
