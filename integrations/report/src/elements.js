// Elements with text in them. Text from files only ever becomes text, never markup.

/** `element( 'p.hint', { title: '…' }, child, 'text' )` */
export function element( tag, properties = {}, ...children ) {

	const [ name, ...classes ] = tag.split( '.' );
	const made = document.createElement( name );
	if ( classes.length ) made.className = classes.join( ' ' );
	for ( const [ key, value ] of Object.entries( properties ) ) {

		if ( key.startsWith( 'on' ) ) made.addEventListener( key.slice( 2 ), value );
		else if ( key in made ) made[ key ] = value;
		else made.setAttribute( key, value );

	}

	made.append( ...children.flat( Infinity ).filter( ( child ) => child !== null && child !== undefined && child !== false ).map( plain ) );
	return made;

}

// Control characters would hide, or turn round, what stands beside them.
function plain( child ) {

	return typeof child === 'object' ? child : String( child ).replace( /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u2028-\u202e\u2066-\u2069]/g, '\ufffd' );

}

export function table( head, rows, options = {} ) {

	return element( 'div.wide', {}, element( 'table', {},
		element( 'thead', {}, element( 'tr', {}, head.map( ( text ) => element( 'th', { scope: 'col' }, text ) ) ) ),
		element( 'tbody', {}, rows.map( ( row ) => element( 'tr', {}, row.map( ( cell, k ) => element( typeof cell === 'number' || options.numbers?.includes( k ) ? 'td.number' : 'td', {}, cell ) ) ) ) ) ) );

}

export const section = ( title, ...children ) => element( 'section', {}, element( 'h2', {}, title ), ...children );
export const percent = ( share, digits = 1 ) => share === null || share === undefined ? '–' : `${ ( 100 * share ).toFixed( digits ) } %`;
export const place = ( position ) => position.map( ( x ) => x.toFixed( 2 ) ).join( ' ' );
export const bytesText = ( n ) => n < 10_000 ? `${ n } B` : n < 10_000_000 ? `${ ( n / 1000 ).toFixed( 1 ) } kB` : `${ ( n / 1e6 ).toFixed( 1 ) } MB`;
