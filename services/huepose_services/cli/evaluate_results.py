"""`huepose eval results`: a Markdown page from result files."""

from __future__ import annotations

import argparse

from huepose.datasets.files import read_json
from huepose.evaluation.result_files import result_names
from huepose.evaluation.results_page import results_page, with_cut
from huepose.support.files import write_text
from huepose.support.words import counted


def call(arguments: argparse.Namespace) -> int:
    """Read the results, write the page."""
    paths = arguments.results
    records = {name: read_json(path) for name, path in zip(result_names(paths), paths, strict=True)}
    write_text(arguments.out, results_page(records))
    if arguments.readme is not None:
        write_text(arguments.readme, with_cut(arguments.readme.read_text(), records))
    print(f"{arguments.out}: {counted(len(records), 'result')}")
    return 0
