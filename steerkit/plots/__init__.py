"""Pictures: one style; signals of a log, courses, the diagram of a loop, films."""
