// Names of the server as words for people.
/** @param {string} name with underlines */
export function spoken(name) {
  const words = name.replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}
