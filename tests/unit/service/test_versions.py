"""The commit that a log was made with."""

import subprocess
from importlib.metadata import version
from pathlib import Path

from semlive.service.runtime.versions import commit_of, versions


def git(folder: Path, *arguments: str) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    return subprocess.run(["git", "-C", str(folder), *who, *arguments], capture_output=True, text=True, check=True).stdout.strip()


def test_the_commit_is_that_of_the_folder_and_reports_whether_files_were_changed(tmp_path: Path) -> None:
    git(tmp_path, "init", "-q")
    (tmp_path / "file").write_text("one", encoding="utf-8")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "-q", "-m", "first")
    head = git(tmp_path, "rev-parse", "HEAD")
    assert len(head) == 40
    assert commit_of("no-such-package", tmp_path) == head
    (tmp_path / "file").write_text("two", encoding="utf-8")
    assert commit_of("no-such-package", tmp_path) == f"{head}-dirty"


def test_without_a_repository_the_commit_is_unknown(tmp_path: Path) -> None:
    assert commit_of("no-such-package", tmp_path) == ""


def test_a_log_names_what_it_was_made_with() -> None:
    reported = versions(("numpy",))
    assert reported["semlive"] == version("semlive")
    assert reported["numpy"] == version("numpy")
