"""The result tables: their columns, how rows are journalled and merged, where they were made."""
