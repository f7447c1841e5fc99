"""What `import bench` offers beside the diagnosis: runs and checks, without a terminal."""
