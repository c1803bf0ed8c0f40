"""The regression gate: tables against those of an older revision, by column rules; speed in pairs."""

from contactbench.report.chapters import discovered

discovered()  # modules of chapters may declare tables, which are compared too
