"""Where runs are computed: in this process, or on workers."""
