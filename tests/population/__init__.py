"""What many people say of the next one."""
