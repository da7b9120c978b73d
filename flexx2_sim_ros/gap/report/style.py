"""CSS that the pages of a diagnosis and of a check share."""

STYLE = """
td, th { padding: .18rem .9rem .18rem 0; text-align: left; vertical-align: top; }
th, small, .dim, figcaption { color: var(--dim); }
.tag { display: inline-block; padding: .1rem .6rem; border-radius: 1rem; color: #fff;
  font-weight: 600; background: #5a6b7b; }
.bar { width: 10rem; height: 1rem; max-width: none; display: block; }
.before { fill: var(--gray); } .after { fill: var(--blue); } .null { fill: var(--ink); }
"""
