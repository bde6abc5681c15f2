"""How the HTML report looks: on a screen, light or dark, and on paper."""

from __future__ import annotations

__all__ = ["STYLE"]

STYLE = """
:root {
  --paper: #fff; --ink: #1d1f21; --muted: #62666b; --rule: #d9d9d4; --tint: #f4f4f0;
  --accent: #1f5f99; --alarm: #8a4b00; --alarm-tint: #fff3dc; --alarm-rule: #e0a94a;
  --serif: "Iowan Old Style", "Palatino Linotype", Palatino, "Source Serif 4", "Noto Serif", Georgia, serif;
  --sans: system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "Helvetica Neue", Arial, sans-serif;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #16181b; --ink: #e4e4df; --muted: #a0a4a9; --rule: #3a3e43; --tint: #1f2226;
    --accent: #8bbcec; --alarm: #ffd591; --alarm-tint: #3a2c10; --alarm-rule: #8a6a2a;
  }
}
* { box-sizing: border-box; }
html { color-scheme: light dark; -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 1.0625rem/1.6 var(--serif); }
main { max-width: 70rem; margin: 0 auto; padding: 4rem 2rem 6rem; }
.running { display: none; }
p, ul { max-width: 43rem; margin: 0 0 1rem; hyphens: auto; }
h1, h2, h3 { line-height: 1.2; font-weight: 600; text-wrap: balance; break-after: avoid; }
h1 { font-size: 2.5rem; max-width: 48rem; margin: 0 0 .6rem; letter-spacing: -.012em; }
h2 { font-size: 1.65rem; margin: 4rem 0 1rem; padding-top: 1.1rem; border-top: 1px solid var(--rule); }
h3 { font-size: 1.2rem; margin: 2.4rem 0 .7rem; }
.subtitle { color: var(--muted); font-size: 1.15rem; margin-bottom: 1.6rem; }
a { color: var(--accent); text-decoration-thickness: .06em; text-underline-offset: .18em; }
code { font: .86em/1.4 ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace;
  background: var(--tint); padding: .1em .3em; border-radius: .2em; overflow-wrap: anywhere; }
li { margin-bottom: .35rem; }
li::marker { color: var(--muted); }
.banner { max-width: none; margin: 1.5rem 0 2rem; padding: 1rem 1.25rem; font: 600 1.05rem/1.5 var(--sans);
  color: var(--alarm); background: var(--alarm-tint); border: 1px solid var(--alarm-rule); border-left-width: .5rem; }
.note { font: .92rem/1.5 var(--sans); color: var(--alarm); padding-left: .9rem;
  border-left: .2rem solid var(--alarm-rule); }
nav { font: .95rem/1.5 var(--sans); margin: 2rem 0; }
nav ul { list-style: none; max-width: none; padding: 0; columns: 17rem; column-gap: 3rem; }
nav li { margin: 0 0 .3rem; break-inside: avoid; }
nav .level3 { padding-left: 1.2rem; font-size: .93em; }
nav a { text-decoration: none; }
nav a:hover, nav a:focus-visible { text-decoration: underline; }
.scroll { overflow-x: auto; margin: 1.5rem 0 2rem; }
table { border-collapse: collapse; font: .84rem/1.4 var(--sans); font-variant-numeric: tabular-nums lining-nums; }
caption, figcaption { font: .9rem/1.5 var(--sans); color: var(--muted); text-align: left; }
caption { caption-side: top; padding-bottom: .7rem; }
caption b, figcaption b { color: var(--ink); font-weight: 600; margin-right: .35em; }
th, td { padding: .34rem .65rem; text-align: right; vertical-align: top; white-space: nowrap; }
th { font-weight: 600; vertical-align: bottom; white-space: normal; }
th:first-child, td:first-child { padding-left: 0; }
th:last-child, td:last-child { padding-right: 0; }
.words { text-align: left; }
thead { border-bottom: 1.5px solid var(--ink); }
tbody { border-bottom: 1px solid var(--rule); }
tbody:last-child { border-bottom: 1.5px solid var(--ink); }
.reference tbody tr:first-child { color: var(--muted); font-style: italic; }
figure { display: inline-block; max-width: 100%; margin: 1.2rem 0 1.8rem; vertical-align: top; break-inside: avoid; }
img { display: block; max-width: 100%; height: auto; background: #fff; border-radius: .35rem; }
figcaption { max-width: 43rem; margin-top: .6rem; }
@media (max-width: 40rem) { main { padding: 2rem 1.1rem 4rem; } h1 { font-size: 1.9rem; } h2 { font-size: 1.4rem; } }
@page { size: A4; margin: 17mm 16mm 19mm;
  @bottom-center { content: counter(page); font: 9pt sans-serif; color: #666; } }
@media print {
  :root { --paper: #fff; --ink: #000; --muted: #444; --rule: #bbb; --tint: #f2f2f2;
    --accent: #000; --alarm: #7a4200; --alarm-tint: #fff; --alarm-rule: #c98a2b; }
  html { color-scheme: light; font-size: 80%; }
  .sheet { display: table; width: 100%; table-layout: fixed; }
  .running { display: table-header-group; break-inside: avoid; font: 600 9pt/1.4 var(--sans); color: var(--alarm); }
  .running::after { content: ""; display: block; height: 5mm; border-top: 1px solid var(--alarm-rule); }
  main { display: table-row-group; padding: 0; max-width: none; }
  p, ul, figcaption { max-width: none; orphans: 3; widows: 3; }
  h2 { margin-top: 2rem; }
  h2 + .note, h3 + .note { break-after: avoid; }
  a { text-decoration: none; }
  .scroll { overflow: visible; break-inside: avoid; }
  table { font-size: 7.6pt; }
  th, td { padding: .25rem .4rem; }
  tr { break-inside: avoid; }
  img { border-radius: 0; }
}
"""
