"""What every other package stands on: errors, arguments, files, folders, memory, progress, tasks, tables, versions."""
