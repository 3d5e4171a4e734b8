"""Run by alembic: migrations go over the connection that the journal hands in, within its transaction."""

from alembic import context

from tilefab.io.journal_schema import metadata

context.configure(connection=context.config.attributes["connection"], target_metadata=metadata)
context.run_migrations()
