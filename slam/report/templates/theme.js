// Light or dark: as the system says, until the button is pressed.
(() => {
  const root = document.documentElement;
  const toggle = document.getElementById("theme");
  const wanted = window.matchMedia("(prefers-color-scheme: dark)");

  const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : wanted.matches);
  const nameToggle = () => { toggle.textContent = isDark() ? "Light page" : "Dark page"; };
  toggle.hidden = false;
  toggle.addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    nameToggle();
  });
  wanted.addEventListener("change", nameToggle);
  nameToggle();
})();
