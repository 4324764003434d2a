"""What is wrong with recordings: each fault found, undone or limited, and told; and the verdict that follows."""
