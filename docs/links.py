"""Links of the pages to files outside the book: they lead to the repository, and must exist, with
the heading that they name.

The pages are read in the repository, too, where such a link is right as it stands.
"""

import re
from pathlib import Path

from mkdocs.exceptions import PluginError

HEADING = re.compile(r"^#+ +(?P<text>.*?) *$", re.MULTILINE)
LINK = re.compile(r"\]\((?P<path>\.\.?/[^)#\s]*)(?P<anchor>#[^)\s]*)?\)")


def anchors(page):
    """The anchors of the headings of a page, as forges make them."""
    texts = (heading["text"].lower() for heading in HEADING.finditer(page.read_text()))
    return {"#" + re.sub(r"[^\w\- ]", "", text).replace(" ", "-") for text in texts}


def on_page_markdown(markdown, page, config, **_):
    docs = Path(config["docs_dir"]).resolve()
    here = docs / page.file.src_uri

    def in_repository(link):
        target = (here.parent / link["path"]).resolve()
        if not target.is_relative_to(docs.parent):
            raise PluginError(f"{page.file.src_uri}: {link['path']} leads out of the repository")
        inside = target.is_relative_to(docs)
        # A folder is no page: it is looked at in the repository.
        if inside and not target.is_dir():
            return link[0]
        if not target.exists():
            raise PluginError(f"{page.file.src_uri}: there is no {link['path']}")
        if link["anchor"] and target.suffix == ".md" and link["anchor"] not in anchors(target):
            raise PluginError(
                f"{page.file.src_uri}: {link['path']} has no heading {link['anchor']}"
            )
        kind = "tree" if target.is_dir() else "blob"
        place = target.relative_to(docs.parent).as_posix()
        return f"]({config['repo_url']}/{kind}/main/{place}{link['anchor'] or ''})"

    return LINK.sub(in_repository, markdown)
