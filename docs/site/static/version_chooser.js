// The list of versions lies in the folder above this one; a host with a chooser of its own has none.
const root = document.documentElement.dataset.content_root;

function showVersions(names) {
  const here = new URL(root, location.href).pathname.split("/").at(-2);
  const chooser = document.createElement("select");
  chooser.setAttribute("aria-label", "version of the pages");
  chooser.className = "version-chooser";
  for (const name of names) chooser.add(new Option(`version ${name}`, name, false, name === here));
  chooser.addEventListener("change", () => { location.href = `${root}../${chooser.value}/index.html`; });
  document.querySelector(".sidebar-brand")?.after(chooser);
}

const list = document.createElement("script");
list.src = `${root}../versions.js`;
document.head.append(list);
