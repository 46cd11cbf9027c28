"""The imperative shell: processes, threads, files, sockets."""
